//! Route of learning results to the store and to the device.

use std::sync::{Arc, Weak};
use std::time::Duration;

use ihd_model::{EventKind, Fit, RecordKind};
use ihd_store::{Certainty, CurveSource, NewResult};
use tokio::sync::mpsc;

use crate::device::DeviceRequest;
use crate::learning::{FitTrace, LearnResult, Learner, LookupToPush};
use crate::machine::Machine;
use crate::printable::printable;
use crate::store_thread::StoreThread;
use crate::supervisor::Devices;
use crate::window_accounting::WindowCounter;

/// Stores and publishes results, and pushes their lookups, until the learner ends.
pub async fn route_results(
    mut outcomes: mpsc::Receiver<LearnResult>,
    devices: Arc<Devices>,
    store: StoreThread,
    learner: Weak<Learner>,
    machine: Machine,
) {
    while let Some(mut learned) = outcomes.recv().await {
        let (device, forgotten_count) = (learned.device.clone(), learned.forgotten_count);
        let has_forgotten = |learner: Arc<Learner>| learner.has_forgotten(&device, forgotten_count);
        if learner.upgrade().is_some_and(has_forgotten) {
            learned.leave_result_only();
        }
        let new_lookup = learned.new_lookup.clone();
        store_result(learned, &devices, &store, machine.now_ms()).await;
        let Some(built) = new_lookup else { continue };
        let version = built.lookup.version;
        let push = DeviceRequest::PushLookup {
            lookup: Box::new(LookupToPush {
                certainty: Some(Certainty::quantise(&built.confidence(), &built.sigma())),
                lookup: built.lookup,
            }),
            forgotten_count,
        };
        if !request(&devices, &device, push)
            && let Some(learner) = learner.upgrade()
        {
            // The learner builds it again from the next result.
            learner.lookup_refused(&device, version);
        }
    }
}

/// Counts, stores and publishes a result.
async fn store_result(learned: LearnResult, devices: &Devices, store: &StoreThread, at_ms: i64) {
    let handle = devices.get(&learned.device);
    if let Some(handle) = handle.as_ref().filter(|_| !learned.is_late) {
        let mut inner = handle.record.lock();
        match learned.result.pass {
            true => inner.windows.count(WindowCounter::Learned),
            false => inner.windows.count(WindowCounter::Unfit),
        }
    }
    let result = learned.result;
    let kind = EventKind::ResultStored {
        boot: learned.boot,
        seq: result.seq,
        f_sw_hz: result.f_sw_hz,
        r_ohm: result.r_ohm,
        l_h: result.l_h,
        pass: result.pass,
        why: printable(&result.why),
    };
    let fit = fit(at_ms, learned.boot, &result, &learned.trace, learned.busy);
    let curve = learned.trace.curve;
    let (state, device_id) = (learned.state, learned.device_id);
    let no_lookup = learned.no_lookup.map(|why| printable(&why));
    if let Some(why) = &no_lookup {
        tracing::info!(device = learned.device, why, "no lookup");
    }
    let store = store.writing_once(RecordKind::Results);
    let stored = store.run(move |store| {
        store.record_result(&result, state.as_deref())?;
        if let Some(curve) = curve {
            // Skipped by the store if the samples of the window are not kept.
            store.keep_curve(result.session, result.seq, CurveSource::Network, &curve)?;
        }
        match no_lookup {
            Some(why) => store.event(Some(device_id), "no lookup", &why),
            None => Ok(()),
        }
    });
    // Errors of the store are reported by its thread.
    if stored.await.is_err() {
        return;
    }
    if let Some(confirmation) = learned.stored {
        // A requester that left meanwhile asks again.
        let _ = confirmation.send(());
    }
    if let Some(handle) = handle {
        handle.record.fits().push(fit);
        handle.record.publish(kind);
    }
}

/// Returns the report of a fit with its trace.
fn fit(at_ms: i64, boot: u32, result: &NewResult, trace: &FitTrace, busy: Duration) -> Fit {
    let finite = |x: f64| x.is_finite().then_some(x);
    Fit {
        boot,
        seq: result.seq,
        at_ms,
        f_sw_hz: result.f_sw_hz,
        r_ohm: finite(result.r_ohm),
        l_h: finite(result.l_h),
        sigma_r_pct: finite(result.sigma_r_pct),
        sigma_l_pct: finite(result.sigma_l_pct),
        pass: result.pass,
        why: printable(&result.why),
        remarks: trace.remarks.clone(),
        changed_lookup: result.changed_lookup,
        iterations: result.iterations,
        seconds: Some(busy.as_secs_f64()),
        steps: trace.steps.clone(),
        r_error_pct: trace.r_error_pct,
        l_error_pct: trace.l_error_pct,
    }
}

/// Sends a request to the device's task. Returns `false` if there is no such task or its queue is full.
fn request(devices: &Devices, device: &str, request: DeviceRequest) -> bool {
    let handle = devices.get(device);
    handle.is_some_and(|handle| handle.requests.try_send(request).is_ok())
}
