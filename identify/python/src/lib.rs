//! The compiled part of the Python package `forcetwin`: what `python/forcetwin/__init__.pyi` describes, over NumPy arrays.
//!
//! Arrays are read where they lie when they are contiguous doubles, and all loops run in Rust without Python's lock.

mod arrays;
mod recording;
mod twin;

use pyo3::prelude::*;

/// Identified twins of doors and drawers: their effort over arrays, recordings, the identification.
#[pymodule]
mod _forcetwin {
    #[pymodule_export]
    use crate::recording::{Identified, Samples, identify, read};
    #[pymodule_export]
    use crate::twin::Twin;
}

/// A wrong argument or file.
fn wrong(error: impl core::fmt::Display) -> PyErr {
    pyo3::exceptions::PyValueError::new_err(error.to_string())
}

/// Something that cannot be computed from what is there.
fn impossible(error: impl core::fmt::Display) -> PyErr {
    pyo3::exceptions::PyRuntimeError::new_err(error.to_string())
}
