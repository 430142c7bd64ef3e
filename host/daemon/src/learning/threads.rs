//! Threads of the learner: each takes the next window from the queue, identifies it and hands its result over.

use std::sync::PoisonError;
use std::time::Instant;

use super::fit_window::{WindowResult, fit_window};
use super::job::{LearnJob, LearnResult};
use super::queue::DeviceLearning;
use super::settle::{hand_over, settle};
use super::shared::{Shared, guarded};

/// Learns from one window after the other until the learner is closed.
pub(super) fn run_thread(shared: &Shared) {
    while let Some((job, device_learning)) = next_job(shared) {
        learn(shared, job, device_learning);
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
pub(super) fn learn(shared: &Shared, mut job: LearnJob, mut device_learning: Box<DeviceLearning>) {
    let began = Instant::now();
    let stored = job.stored.take();
    let result = guarded(shared, &mut device_learning, |device_learning| {
        let mut window_result = fit_window(shared, device_learning, &job);
        window_result.busy = window_result.busy.max(began.elapsed());
        settle(shared, device_learning, &job, window_result)
    });
    let result = result.unwrap_or_else(|why| {
        // The network's start parameters may have caused the panic.
        device_learning.learning.start_cold();
        let window_result = WindowResult::unfit(job.input.window(), why, began.elapsed());
        settle(shared, &mut device_learning, &job, window_result)
    });
    hand_over(shared, LearnResult { stored, ..result });
    let mut state = shared.lock();
    state.queue.return_learning(&job.device, device_learning);
    drop(state);
    shared.changed.notify_one();
}
