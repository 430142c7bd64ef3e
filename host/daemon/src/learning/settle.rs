//! End of a window: the device's queued events are applied, the record for the store is built, and the result is handed over.

use std::thread;
use std::time::{Duration, Instant};

use ihd_store::NewResult;
use ihd_train::learning::LookupUpdate;
use tokio::sync::mpsc::error::TrySendError;

use super::identify::WindowResult;
use super::job::{LearnJob, LearnResult};
use super::queue::{DeviceLearning, LearningEvent};
use super::shared::Shared;

/// Longest time between two saves of a device's learning to the store while its lookup does not change.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// Longest wait of a thread of a closed learner for room in the channel of results.
const HAND_OVER_WITHIN: Duration = Duration::from_secs(2);

/// Pause between two attempts to hand over a result.
const HAND_OVER_PERIOD: Duration = Duration::from_millis(5);

/// Applies the events queued during the identification and builds the result for the store.
pub(super) fn settle(
    shared: &Shared,
    known: &mut DeviceLearning,
    job: &LearnJob,
    found: WindowResult,
) -> LearnResult {
    let (mut new_lookup, no_lookup) = match found.taught {
        LookupUpdate::Unchanged => (None, None),
        LookupUpdate::New(built) => (Some(built), None),
        LookupUpdate::Refused(why) => (None, Some(why)),
    };
    let events = {
        let mut state = shared.lock();
        state.meter.add_fit(found.busy);
        state.queue.take_events(&job.device)
    };
    for event in events {
        event.apply(&mut known.learning);
        if event == LearningEvent::Forget {
            new_lookup = None;
        }
    }
    let state = known.take_due_save(new_lookup.is_some(), SAVE_EVERY);
    let summary = found.summary;
    LearnResult {
        device: job.device.clone(),
        device_id: job.device_id,
        boot: job.boot,
        result: NewResult {
            session: job.session,
            seq: found.seq,
            half_cycle: found.half_cycle,
            f_sw_hz: found.f_sw_hz,
            i_crest_a: summary.i_crest_a,
            power_w: job.power_w,
            r_ohm: summary.r_ohm,
            l_h: summary.l_h,
            sigma_r_pct: summary.sigma_r_pct,
            sigma_l_pct: summary.sigma_l_pct,
            pass: found.refused.is_none(),
            why: found.refused.unwrap_or_default(),
            changed_lookup: new_lookup.is_some(),
            iterations: summary.iterations,
        },
        new_lookup,
        no_lookup,
        state,
        busy: found.busy,
        trace: Box::new(found.trace),
        stored: None,
    }
}

/// Sends a result and waits for room in the channel. Gives up if the receiver is gone, or [`HAND_OVER_WITHIN`] after the learner was
/// closed.
pub(super) fn hand_over(shared: &Shared, mut learned: LearnResult) {
    let mut closing_since = None;
    loop {
        match shared.outcomes.try_send(learned) {
            Ok(()) | Err(TrySendError::Closed(_)) => return,
            Err(TrySendError::Full(back)) => learned = back,
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
