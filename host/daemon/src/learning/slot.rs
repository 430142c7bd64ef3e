//! Learner of the daemon, until it stops.

use std::sync::{Arc, Mutex};

use super::learner::Learner;
use crate::locking::lock;

/// Place of the learner; empty once the daemon stops. Clones share it.
#[derive(Clone)]
pub struct LearnerSlot(Arc<Mutex<Option<Arc<Learner>>>>);

impl LearnerSlot {
    /// Puts a learner in a new place.
    pub fn new(learner: Arc<Learner>) -> Self {
        Self(Arc::new(Mutex::new(Some(learner))))
    }

    /// Returns the learner; `None` once the daemon stops.
    pub fn get(&self) -> Option<Arc<Learner>> {
        lock(&self.0).clone()
    }

    /// Empties the place.
    pub fn clear(&self) {
        drop(lock(&self.0).take());
    }
}
