//! Learner without threads, for the simulated machine of tests.

use ihd_link::Window;
use ihd_train::Learning;
use ihd_train::learning::WindowOutcome;
use tokio::sync::mpsc::Sender;

use super::job::LearnResult;
use super::learner::{Learner, LearnerError, LearnerSettings};
use super::threads::learn;
use crate::machine::Machine;

impl Learner {
    /// Starts the threads, or none on a simulated machine.
    ///
    /// # Errors
    /// The same as for [`Learner::start`].
    pub fn start_on(
        machine: &Machine,
        settings: LearnerSettings,
        outcomes: Sender<LearnResult>,
    ) -> Result<Self, LearnerError> {
        match machine.disk() {
            Some(_) => Ok(Self::simulated(settings, outcomes)),
            None => Self::start(settings, outcomes),
        }
    }

    /// Creates a learner without threads that refuses every window.
    pub fn simulated(settings: LearnerSettings, outcomes: Sender<LearnResult>) -> Self {
        let unfit = |_: &mut Learning, _: &Window| WindowOutcome::Refused {
            why: "simulated".to_owned(),
            identified: None,
            findings: Vec::new(),
        };
        Self::without_threads(settings, outcomes, Box::new(unfit))
    }

    /// Learns from the next window that waits. Returns `false` if none does, or the channel of results is full.
    pub fn learn_one(&self) -> bool {
        if self.shared.outcomes.capacity() == 0 {
            return false;
        }
        let next = self.shared.lock().queue.next();
        let Some((job, device_learning)) = next else {
            return false;
        };
        learn(&self.shared, job, device_learning);
        true
    }
}
