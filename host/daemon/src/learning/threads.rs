//! Threads of the learner: each takes the next window from the queue, identifies it and hands its result over.

use std::sync::PoisonError;
use std::time::Instant;

use super::identify::{WindowResult, identify};
use super::job::{LearnJob, LearnResult};
use super::queue::DeviceLearning;
use super::settle::{hand_over, settle};
use super::shared::{Shared, guarded};

/// Learns from one window after the other until the learner is closed.
pub(super) fn run_thread(shared: &Shared) {
    while let Some((job, known)) = next_job(shared) {
        learn(shared, job, known);
    }
}

/// Waits for the next window; `None` if the learner is closed.
fn next_job(shared: &Shared) -> Option<(LearnJob, Box<DeviceLearning>)> {
    let mut state = shared.lock();
    loop {
        if state.closing {
            return None;
        }
        if let Some(next) = state.queue.next() {
            return Some(next);
        }
        state = shared
            .changed
            .wait(state)
            .unwrap_or_else(PoisonError::into_inner);
    }
}

/// Learns from one window and hands its result over. After a panic the window counts as refused, and the device's learning stays as it was.
pub(super) fn learn(shared: &Shared, mut job: LearnJob, mut known: Box<DeviceLearning>) {
    let began = Instant::now();
    let stored = job.stored.take();
    let learned = guarded(shared, &mut known, |known| {
        let mut found = identify(shared, known, &job);
        found.busy = found.busy.max(began.elapsed());
        settle(shared, known, &job, found)
    });
    let learned = learned.unwrap_or_else(|why| {
        // The network's start parameters may have caused the panic.
        known.learning.start_cold();
        let found = WindowResult::unfit(job.input.window(), why, began.elapsed());
        settle(shared, &mut known, &job, found)
    });
    hand_over(shared, LearnResult { stored, ..learned });
    let mut state = shared.lock();
    state.queue.return_learning(&job.device, known);
    drop(state);
    shared.changed.notify_one();
}
