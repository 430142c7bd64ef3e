//! End of a window: the device's queued events are applied, the record for the store is built, and the result is handed over.

use std::thread;
use std::time::{Duration, Instant};

use ihd_store::NewResult;
use ihd_train::learning::LookupUpdate;
use tokio::sync::mpsc::error::TrySendError;

use super::fit_window::WindowResult;
use super::job::{LearnJob, LearnResult};
use super::queue::DeviceLearning;
use super::shared::Shared;

/// Longest time between two saves of a device's learning to the store while its lookup does not change.
const SAVE_PERIOD: Duration = Duration::from_secs(10);

/// Longest wait of a thread of a closed learner for room in the channel of results.
const HAND_OVER_WITHIN: Duration = Duration::from_secs(2);

/// Pause between two attempts to hand over a result.
const HAND_OVER_PERIOD: Duration = Duration::from_millis(5);

/// Applies the events queued during the identification and builds the result for the store.
pub(super) fn settle(
    shared: &Shared,
    device_learning: &mut DeviceLearning,
    job: &LearnJob,
    window_result: WindowResult,
) -> LearnResult {
    let (mut new_lookup, no_lookup) = match window_result.update {
        LookupUpdate::Unchanged => (None, None),
        LookupUpdate::New(built) => {
            device_learning.clear_no_lookup();
            (Some(built), None)
        }
        LookupUpdate::Refused(why) => (None, device_learning.change_no_lookup(why)),
    };
    let (events, forgotten_count) = {
        let mut state = shared.lock();
        state.meter.add_fit(window_result.busy);
        if window_result.is_late {
            state.queue.count_late(&job.device);
        }
        let forgotten_count = state.queue.forgotten_count(&job.device);
        (state.queue.take_events(&job.device), forgotten_count)
    };
    for event in events {
        event.apply(&mut device_learning.learning);
        if event.forgets() {
            new_lookup = None;
        }
    }
    let state = device_learning.take_due_save(new_lookup.is_some(), SAVE_PERIOD);
    let summary = window_result.summary;
    LearnResult {
        device: job.device.clone(),
        device_id: job.device_id,
        boot: job.boot,
        result: NewResult {
            session: job.session,
            seq: window_result.seq,
            half_cycle: window_result.half_cycle,
            f_sw_hz: window_result.f_sw_hz,
            i_crest_a: summary.i_crest_a,
            power_w: job.power_w,
            r_ohm: summary.r_ohm,
            l_h: summary.l_h,
            sigma_r_pct: summary.sigma_r_pct,
            sigma_l_pct: summary.sigma_l_pct,
            pass: window_result.refused.is_none(),
            why: window_result.refused.unwrap_or_default(),
            changed_lookup: new_lookup.is_some(),
            iterations: summary.iterations,
        },
        forgotten_count,
        is_late: window_result.is_late,
        new_lookup,
        no_lookup,
        state,
        busy: window_result.busy,
        trace: Box::new(window_result.trace),
        stored: None,
    }
}

/// Sends a result and waits for room in the channel. Gives up if the receiver is gone, or [`HAND_OVER_WITHIN`] after the learner was
/// closed.
pub(super) fn hand_over(shared: &Shared, mut result: LearnResult) {
    let mut closing_since = None;
    loop {
        match shared.outcomes.try_send(result) {
            Ok(()) | Err(TrySendError::Closed(_)) => return,
            Err(TrySendError::Full(back)) => result = back,
        }
        if shared.lock().closing {
            let since: Instant = *closing_since.get_or_insert_with(Instant::now);
            if since.elapsed() >= HAND_OVER_WITHIN {
                return;
            }
        }
        thread::sleep(HAND_OVER_PERIOD);
    }
}
