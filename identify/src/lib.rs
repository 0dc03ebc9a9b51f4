//! Joint, dynamics and what the model lacks, identified from a recording.
//!
//! ```text
//! Recording -> samples -> grasp, payload -> screw, joint_graph -> effort -> motion -> dynamics -> report, twin
//!   (MCAP)    one grid    free air, bias   type, axis, q(t)      tau     filtered   I, mu, b, g(q), c(q,|dq|)
//! ```
//!
//! Everything after `effort` sees a joint coordinate and a generalized effort only ([`JointSamples`]), so tables of
//! position and effort run through the same code as recordings.
#![forbid(unsafe_code)]
// A series is cut into runs, and often into one.
#![allow(clippy::single_range_in_vec_init)]

pub mod analysis;
pub mod batch;
pub mod diagnose;
mod digits;
pub mod dynamics;
pub mod effect;
pub mod effort;
pub mod error;
pub mod export;
mod factor;
pub mod filter;
pub mod grasp;
pub mod joint_graph;
pub mod lag;
pub mod least_squares;
pub mod mechanism;
pub mod motion;
pub mod noise;
pub mod output;
pub mod page;
pub mod paper;
mod parallel;
pub mod payload;
pub mod pipeline;
mod products;
mod random;
pub mod report;
pub mod samples;
pub mod saturation;
pub mod screw;
pub mod simulate;
pub mod spline;
pub mod table;
pub mod tool;
pub mod track;
pub mod twin;

/// The README's Rust is compiled.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
