//! Where items go: the recording and the network.

use ft_wire::HostTime;

use crate::item::Item;

pub mod mcap;
pub mod zenoh;

/// Takes items in the order of arrival.
pub trait Sink {
    /// Takes one item.
    ///
    /// # Errors
    /// The sink cannot go on. A recording stops, a live view drops and counts.
    fn take(&mut self, item: &Item) -> Result<(), SinkError>;

    /// Time went by; called at least every 50 ms, items or not.
    ///
    /// # Errors
    /// As for [`Sink::take`].
    fn tick(&mut self, now: HostTime) -> Result<(), SinkError>;
}

/// Why a sink cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SinkError {
    /// The recording cannot be written.
    #[error(transparent)]
    Recording(#[from] ft_recording::writer::WriteError),
    /// The keys of the network cannot be used.
    #[error("keys: {0}")]
    Keys(#[from] crate::keys::KeyError),
    /// The network side failed.
    #[error("zenoh: {what}: {why}")]
    Zenoh {
        /// What was tried.
        what: &'static str,
        /// What Zenoh said.
        why: String,
    },
}
