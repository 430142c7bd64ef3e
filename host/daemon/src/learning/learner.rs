//! The learner: a queue of windows of all devices, and threads that identify them.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{self, JoinHandle};

use ihd_link::Window;
use ihd_map::library::{Library, PotEntry, Provenance};
use ihd_shared::lookup::RlLookup;
use ihd_train::learning::{Contradiction, StateError};
use ihd_train::{Learning, NetworkConfig};
use tokio::sync::mpsc::Sender;

use super::figures::LearnerFigures;
use super::job::{LearnJob, LearnResult};
use super::queue::{DroppedWindow, LearningEvent};
use super::shared::{ObserveFn, Shared};
use super::threads::run_thread;
use super::workers::WorkerFigures;

/// Resources and settings of the learner.
#[derive(Clone, Debug)]
pub struct LearnerSettings {
    /// Number of threads, at least one.
    pub threads: usize,
    /// Most windows that wait for them.
    pub queue: usize,
    /// The network's settings.
    pub network: NetworkConfig,
}

/// Error of starting the learner.
#[derive(Debug, thiserror::Error)]
pub enum LearnerError {
    /// A thread could not be started.
    #[error("cannot start a learner thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// A thread is using the device's learning, until the end of its current window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a window of the device is being learned from")]
pub struct LearningInUse;

/// Learner with threads of its own. Dropping it ends them without waiting for them.
pub struct Learner {
    pub(super) shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    network: NetworkConfig,
    limit: usize,
}

impl Learner {
    /// Starts the threads; a machine of the product is never simulated.
    ///
    /// # Errors
    /// The same as for [`Learner::start`].
    #[cfg(not(any(test, feature = "simulation")))]
    pub fn start_on(
        _: &crate::machine::Machine,
        settings: LearnerSettings,
        outcomes: Sender<LearnResult>,
    ) -> Result<Self, LearnerError> {
        Self::start(settings, outcomes)
    }

    /// Starts the threads. Results go to `outcomes`, those of one device in the order of its windows. While that
    /// channel is full, nothing is learned.
    ///
    /// # Errors
    /// [`LearnerError`] if the system has no thread left.
    pub fn start(
        settings: LearnerSettings,
        outcomes: Sender<LearnResult>,
    ) -> Result<Self, LearnerError> {
        let observe =
            |learning: &mut Learning, window: &Window| learning.observe(window, false, &mut |_| ());
        Self::start_with(settings, outcomes, Box::new(observe))
    }

    pub(super) fn start_with(
        settings: LearnerSettings,
        outcomes: Sender<LearnResult>,
        observe: Box<ObserveFn>,
    ) -> Result<Self, LearnerError> {
        let threads = settings.threads.max(1);
        let mut learner = Self::without_threads(settings, outcomes, observe);
        for n in 0..threads {
            let shared = Arc::clone(&learner.shared);
            let thread = thread::Builder::new()
                .name(format!("learner {n}"))
                .spawn(move || run_thread(&shared))?;
            learner.threads.push(thread);
        }
        Ok(learner)
    }

    pub(super) fn without_threads(
        settings: LearnerSettings,
        outcomes: Sender<LearnResult>,
        observe: Box<ObserveFn>,
    ) -> Self {
        let shared = Arc::new(Shared {
            state: Mutex::default(),
            changed: Condvar::new(),
            observe,
            outcomes,
        });
        Self {
            shared,
            threads: Vec::new(),
            network: settings.network,
            limit: settings.queue.max(1),
        }
    }

    /// Adds a device, or restarts it, with its stored learning. If the bytes are damaged, the
    /// device starts without learning; a known device keeps its learning if `learned` is `None`.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are damaged.
    pub fn add(&self, device: &str, learned: Option<&[u8]>) -> Result<(), StateError> {
        let (learning, damage) = match learned {
            None if self.shared.lock().queue.has_device(device) => return Ok(()),
            None => (Learning::new(self.network.clone()), Ok(())),
            Some(bytes) => match Learning::from_bytes(bytes, self.network.clone()) {
                Ok(learning) => (learning, Ok(())),
                Err(why) => (Learning::new(self.network.clone()), Err(why)),
            },
        };
        self.shared.lock().queue.insert(device, learning);
        damage
    }

    /// Sets the version of the lookup that the device uses: after every handshake, and after its lookup was reset or
    /// pushed from elsewhere.
    pub fn set_device_version(&self, device: &str, version: u32) {
        self.post(device, LearningEvent::DeviceVersion(version));
    }

    /// Sets the device's present boot: after every handshake, and after [`Learner::add`].
    pub fn begin_boot(&self, device: &str, boot: u32) {
        self.post(device, LearningEvent::Boot(boot));
    }

    /// Records that the device has accepted a lookup of this learner.
    pub fn lookup_accepted(&self, device: &str, version: u32) {
        self.post(device, LearningEvent::LookupAccepted(version));
    }

    /// Records that the device has refused a lookup of this learner.
    pub fn lookup_refused(&self, device: &str, version: u32) {
        self.post(device, LearningEvent::LookupRefused(version));
    }

    /// Returns `true` if a device's learning was forgotten again since a result with this count.
    pub fn has_forgotten(&self, device: &str, forgotten_count: u64) -> bool {
        self.shared.lock().queue.forgotten_count(device) > forgotten_count
    }

    /// Forgets the load of a device.
    pub fn forget(&self, device: &str) {
        self.post(device, LearningEvent::Forget);
    }

    /// Forgets the load and the sensors of a device, which is another board.
    pub fn forget_board(&self, device: &str) {
        self.post(device, LearningEvent::Board);
    }

    fn post(&self, device: &str, event: LearningEvent) {
        self.shared.lock().queue.post(device, event);
    }

    /// Queues a window without waiting. If the queue is full, the window that makes room is returned: the oldest of the device
    /// that has most waiting. An unknown device is added.
    pub fn offer(&self, job: LearnJob) -> Option<DroppedWindow> {
        let mut state = self.shared.lock();
        if !state.queue.has_device(&job.device) {
            let learning = Learning::new(self.network.clone());
            state.queue.insert(&job.device, learning);
        }
        let dropped = state.queue.push(job, self.limit);
        state.meter.unlearned += u64::from(dropped.is_some());
        drop(state);
        self.shared.changed.notify_one();
        dropped
    }

    /// Returns the number of a device's windows that were dropped from the queue or came too late.
    pub fn unlearned_count(&self, device: &str) -> u64 {
        self.shared.lock().queue.unlearned_count(device)
    }

    /// Serialises the learning of a device; `None` if it is unknown, or a thread is using its learning.
    #[cfg(test)]
    pub(super) fn state_of(&self, device: &str) -> Option<Vec<u8>> {
        let state = self.shared.lock();
        Some(state.queue.learning(device)?.to_bytes())
    }

    /// Returns an upper limit of the windows that wait or are at a thread.
    pub fn most_pending(&self) -> usize {
        self.shared.lock().queue.waiting() + self.threads.len()
    }

    /// Returns `true` if the device was added, or a window of it came.
    pub fn has_device(&self, device: &str) -> bool {
        self.shared.lock().queue.has_device(device)
    }

    /// Returns `true` if this window waits for a thread, or one has it.
    pub fn is_pending(&self, device: &str, boot: u32, seq: u32) -> bool {
        self.shared.lock().queue.is_pending(device, boot, seq)
    }

    /// Returns the skew in seconds to remove from the current of a device's windows; `None` if they have shown none. While a thread is
    /// using the learning, the value from before.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        self.shared.lock().queue.skew_s(device)
    }

    /// Returns the pot on a device as an entry for the library of other hobs; `None` if a thread is using the learning, or too little is
    /// known.
    pub fn pot_entry(&self, device: &str, by: Provenance) -> Option<PotEntry> {
        // Copied so that the lock is not held while the entry is computed.
        let map = self.shared.lock().queue.learning(device)?.map().clone();
        map.entry(by)
    }

    /// Returns the first place at which a lookup contradicts a device's windows; `None` if there is none.
    ///
    /// # Errors
    /// [`LearningInUse`] if a thread is using the device's learning.
    pub fn contradiction(
        &self,
        device: &str,
        lookup: &RlLookup,
    ) -> Result<Option<Contradiction>, LearningInUse> {
        let state = self.shared.lock();
        match state.queue.learning(device) {
            Some(learning) => Ok(learning.contradiction(lookup)),
            None if state.queue.has_device(device) => Err(LearningInUse),
            None => Ok(None),
        }
    }

    /// Sets the library of other hobs' pots for every device; returns `false` if it has not changed.
    pub fn use_library(&self, library: Library) -> bool {
        self.shared.lock().queue.use_library(Arc::new(library))
    }

    /// Returns the records of workers' answers, by name.
    pub fn workers(&self) -> BTreeMap<String, WorkerFigures> {
        self.shared.lock().workers.workers().clone()
    }

    /// Returns figures of load and queue.
    pub fn figures(&self) -> LearnerFigures {
        let state = self.shared.lock();
        let waiting = state.queue.waiting();
        let running = self.threads.iter().filter(|t| !t.is_finished()).count();
        state.meter.figures(running, waiting)
    }

    /// Ends the threads, each after its current window, and waits for them; waiting windows are dropped. Not to be
    /// called from a task that others wait for.
    pub fn stop(mut self) -> LearnerFigures {
        self.close();
        for thread in self.threads.drain(..) {
            // Panics of the training are caught; another one has been reported.
            let _ = thread.join();
        }
        self.figures()
    }

    fn close(&self) {
        let mut state = self.shared.lock();
        state.closing = true;
        let dropped = state.queue.clear();
        state.meter.unlearned += dropped as u64;
        drop(state);
        self.shared.changed.notify_all();
    }
}

impl Drop for Learner {
    fn drop(&mut self) {
        self.close();
    }
}
