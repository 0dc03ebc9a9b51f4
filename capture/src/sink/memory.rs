//! Keeps items in memory, for tests.

use ft_wire::HostTime;

use super::{Sink, SinkError};
use crate::item::Item;

/// Everything that was taken.
#[derive(Debug, Default)]
pub struct MemorySink {
    /// The items, in the order in which they were taken.
    pub items: Vec<Item>,
}

impl Sink for MemorySink {
    fn take(&mut self, item: &Item) -> Result<(), SinkError> {
        self.items.push(item.clone());
        Ok(())
    }

    fn tick(&mut self, _now: HostTime) -> Result<(), SinkError> {
        Ok(())
    }
}
