//! Time-synchronised capture service: records, publishes and shows what the devices say.
//!
//! ```text
//! link thread (one per device)          writer thread -> MCAP (chunks of 100 ms)
//!   link -> pump -> driver -> channel -> bounded queues -> sync thread -> disk
//!                    (clock translation)  \
//!                                          publisher thread -> Zenoh, as rmw_zenoh names it
//! ```
//!
//! Acquisition never waits for the disk or for a viewer: a full queue drops and counts.

pub mod calibrate;
pub mod channel;
pub mod config;
pub mod encode;
pub mod foxglove;
pub mod gyro;
pub mod health;
pub mod import;
pub mod init;
pub mod item;
pub mod keys;
pub mod ledger;
pub mod live;
pub mod logging;
pub mod merge;
pub mod network;
pub mod open;
pub mod queues;
mod recovery;
pub mod remote;
pub mod rmw;
pub mod session;
pub mod settings;
#[cfg(feature = "sim")]
pub mod simulated;
pub mod sink;
pub mod stop;
pub mod summary;
pub mod terminal;
pub mod web;
pub mod zenoh_link;
