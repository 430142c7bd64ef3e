//! Truth of the last half-cycles, for readers that do not wait for the simulation.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use ihd_signal::truth::Truth;

/// Number of half-cycles that are kept: more than the slowest link takes to deliver a window.
const MAX_HALF_CYCLES: usize = 256;

/// Truth of the last half-cycles of a simulated hob. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct RecentTruths(Arc<Mutex<VecDeque<Truth>>>);

impl RecentTruths {
    /// Adds a completed half-cycle and drops the oldest beyond those kept.
    pub(crate) fn push(&self, truth: Truth) {
        let mut truths = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        truths.push_back(truth);
        if truths.len() > MAX_HALF_CYCLES {
            truths.pop_front();
        }
    }

    /// Truth of a completed half-cycle, numbered like the firmware's; `None` if it is not among the last.
    pub fn get(&self, half_cycle: u32) -> Option<Truth> {
        let truths = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        truths.iter().find(|t| t.half_cycle == half_cycle).cloned()
    }
}
