//! Whole-system tests and comparisons with other people's tools.
