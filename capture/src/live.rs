//! What viewers see: one hub takes every message and hands each viewer what it can use, whoever feeds it.
//!
//! ```text
//! ft-capture: publisher thread ─┐        ┌─ strips 50 Hz, state 4 Hz ─► page (bounded queue for each viewer)
//! ft-view:    Zenoh subscriber ─┴─► Hub ─┼─ every message ───────────► Foxglove (bounded queue for each viewer)
//!                                        └─ the latest of everything ► terminal
//! ```
//!
//! Feeding never waits for a viewer: a viewer that is behind loses the oldest, and it is counted.

pub mod derived;
pub mod hub;
pub mod picture;
pub mod strip;

pub use hub::{Frame, Hub, Sample};
