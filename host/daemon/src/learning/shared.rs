//! State that the learner shares with its threads, under one lock.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard};

use ihd_link::Window;
use ihd_train::Learning;
use ihd_train::learning::WindowOutcome;
use tokio::sync::mpsc::Sender;

use super::figures::Meter;
use super::job::LearnResult;
use super::queue::{DeviceLearning, Queue};
use super::workers::WorkerRecords;
use crate::locking::lock;

/// Function by which a thread learns from a window; replaced in tests.
pub(super) type ObserveFn = dyn Fn(&mut Learning, &Window) -> WindowOutcome + Send + Sync;

/// State of the learner, with the condition that wakes its threads.
pub(super) struct Shared {
    pub(super) state: Mutex<State>,
    pub(super) changed: Condvar,
    pub(super) observe: Box<ObserveFn>,
    pub(super) outcomes: Sender<LearnResult>,
}

/// State of the learner, under the lock.
#[derive(Default)]
pub(super) struct State {
    pub(super) queue: Queue,
    pub(super) meter: Meter,
    pub(super) workers: WorkerRecords,
    pub(super) closing: bool,
}

impl Shared {
    /// Locks the state. Poisoning is ignored: nothing that can panic runs while it is held.
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// Calls a function with a copy of a device's learning, which replaces the original. A panic is returned as an error; the original stays.
pub(super) fn guarded<T>(
    shared: &Shared,
    device_learning: &mut DeviceLearning,
    f: impl FnOnce(&mut DeviceLearning) -> T,
) -> Result<T, String> {
    let mut working = device_learning.clone();
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let value = f(&mut working);
        (working, value)
    }));
    match outcome {
        Ok((working, value)) => {
            *device_learning = working;
            Ok(value)
        }
        Err(panic) => {
            shared.lock().meter.panics += 1;
            let text = panic.downcast_ref::<&str>().copied();
            let text = text.or(panic.downcast_ref::<String>().map(String::as_str));
            Err(format!(
                "training panicked: {}",
                text.unwrap_or("no message")
            ))
        }
    }
}
