//! How far a diagnosis goes: from what a search has come to, others are begun elsewhere, and what other recordings refuse begins it anew. Where
//! nothing of the library is what is missing, that could go on for long and comes to nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Steps that all searches of a diagnosis have made. Each surveys the whole library beside the model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Steps(Arc<AtomicUsize>);

/// After so many no other search is begun. A search without what the last one doubts, and the first that is rid of slips, are made all the same.
/// That is some searches of three or four effects each.
const MOST: usize = 28;

impl Steps {
    pub(super) fn count(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether there have been so many that no other search is to be begun.
    pub(crate) fn are_enough(&self) -> bool {
        self.0.load(Ordering::Relaxed) >= MOST
    }
}
