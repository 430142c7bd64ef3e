//! Job of the learner: one window of a device, and its result.

use std::time::Duration;

use ihd_link::Window;
use ihd_shared::lookup::RlLookup;
use ihd_signal::truth::Truth;
use ihd_store::{Certainty, DeviceId, NewResult, SessionId};
use ihd_train::lookup::BuiltLookup;
use tokio::sync::oneshot;

use super::answer::WorkerAnswer;
use super::fit::FitTrace;

/// Input of the learner.
#[derive(Debug)]
pub enum LearnInput {
    /// A window.
    Window(Box<Window>),
    /// A window, and a worker's answer to it.
    Answered(Box<Window>, Box<WorkerAnswer>),
}

impl LearnInput {
    /// Returns the window.
    pub fn window(&self) -> &Window {
        match self {
            Self::Window(window) | Self::Answered(window, _) => window,
        }
    }
}

/// Job of the learner: one window with its origin.
#[derive(Debug)]
pub struct LearnJob {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The session in which the window came.
    pub session: SessionId,
    /// The device's boot.
    pub boot: u32,
    /// The window, with a worker's answer if there is one.
    pub input: LearnInput,
    /// Mean power of its half-cycle in watt; `None` without telemetry.
    pub power_w: Option<f64>,
    /// True R and L; `None` unless the device is simulated in the daemon.
    pub truth: Option<Truth>,
    /// Channel that is signalled when the result is stored.
    pub stored: Option<oneshot::Sender<()>>,
}

/// A lookup to push.
#[derive(Clone, Debug)]
pub struct LookupToPush {
    /// The lookup.
    pub lookup: RlLookup,
    /// Confidence and deviations of its cells; `None` if they are not known.
    pub certainty: Option<Certainty>,
}

impl LookupToPush {
    /// Creates a lookup of which nobody can tell how well its cells are known.
    pub fn without_certainty(lookup: RlLookup) -> Self {
        let certainty = None;
        Self { lookup, certainty }
    }
}

/// Result of a job.
#[derive(Debug)]
pub struct LearnResult {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The device's boot.
    pub boot: u32,
    /// Record for the store: numbers, the gate's verdict and its reason.
    pub result: NewResult,
    /// Number of times that the device's learning had been forgotten before.
    pub forgotten_count: u64,
    /// `true` if the window came too late to be learned; the learner has counted it.
    pub is_late: bool,
    /// New lookup to push; `None` if it has not changed.
    pub new_lookup: Option<Box<BuiltLookup>>,
    /// Reason for which no lookup that a device would accept follows from the window, if it is another than before; learning goes on.
    pub no_lookup: Option<String>,
    /// Serialised learning of the device, to be stored with the result; only from time to time, but
    /// always with a new lookup and with a new frequency.
    pub state: Option<Vec<u8>>,
    /// Duration of the job.
    pub busy: Duration,
    /// Trace of the fit.
    pub trace: Box<FitTrace>,
    /// Channel that is signalled when the result is stored.
    pub stored: Option<oneshot::Sender<()>>,
}

impl LearnResult {
    /// Drops what would bring back learning that was forgotten meanwhile.
    pub fn leave_result_only(&mut self) {
        (self.state, self.new_lookup) = (None, None);
        self.result.changed_lookup = false;
    }
}
