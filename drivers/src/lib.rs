//! Device state machines without I/O, and the links that carry their frames.

pub mod clock;
pub mod device;
pub mod link;
pub mod reading;

pub use clock::{Clock, MonotonicClock, SteppedClock};
pub use device::Device;
pub use link::{Link, LinkError, RxStamps};
