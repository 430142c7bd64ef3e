//! Follower of the pot on a hob: changes of detection, and the pot's temperature on a blocking thread.

use std::sync::Arc;

use ihd_model::EventKind;
use ihd_shared::wire::messages::{Pot, Telemetry};
use ihd_store::DeviceId;
use ihd_thermal::PotEvent;
use tokio::task::JoinHandle;

use crate::device_record::DeviceRecord;
use crate::machine::Machine;
use crate::pot_tracker::describe;
use crate::states::pot_change;
use crate::store_thread::StoreAccess;

/// Capacity of the tracker's queue in half-cycles: many times the duration of a fit.
const QUEUE: usize = 1_000;

/// Largest number of pot events published per batch; a faulty device may cause more.
const MAX_EVENTS: usize = 4;

/// Half-cycles on their way to the pot tracker of a device.
#[derive(Default)]
pub(super) struct PotFollower {
    /// Last known detection.
    detected: Option<Pot>,
    /// Half-cycles with their times in milliseconds since 1970, UTC.
    queue: Vec<(Telemetry, i64)>,
    task: Option<JoinHandle<()>>,
}

impl PotFollower {
    /// Queues a half-cycle; beyond the queue's capacity it is dropped.
    pub(super) fn push(&mut self, t: &Telemetry, now_ms: i64) {
        if self.queue.len() < QUEUE {
            self.queue.push((t.clone(), now_ms));
        }
    }

    /// Returns `true` if the detected pot has changed since a known one.
    pub(super) fn detect(&mut self, pot: Pot) -> bool {
        if pot == Pot::Unknown || self.detected == Some(pot) {
            return false;
        }
        self.detected.replace(pot).is_some()
    }

    /// Feeds the queued half-cycles to the tracker, on a blocking thread, unless it is still busy. New alloys go to `store`, as those
    /// of `device`; without it they wait.
    pub(super) fn track(
        &mut self,
        record: &Arc<DeviceRecord>,
        machine: &Machine,
        device: Option<DeviceId>,
        store: StoreAccess,
    ) {
        let is_busy = self.task.as_ref().is_some_and(|task| !task.is_finished());
        if is_busy || self.queue.is_empty() {
            return;
        }
        let (record, queue) = (Arc::clone(record), std::mem::take(&mut self.queue));
        self.task = Some(machine.spawn_blocking(move || {
            let (mut events, curve, alloys) = {
                let mut tracker = record.pot_tracker();
                let events: Vec<_> = queue
                    .iter()
                    .flat_map(|(t, at_ms)| tracker.push(t, *at_ms))
                    .collect();
                let alloys = device.and_then(|id| Some((id, tracker.take_unstored_alloys()?)));
                (events, tracker.curve(), alloys)
            };
            if let Some((device, json)) = alloys {
                let owner = Arc::clone(&record);
                let is_queued = store.offer(move |store| {
                    let kept = store.keep_alloys(device, &json);
                    if kept.is_err() {
                        owner.pot_tracker().alloys_were_not_stored();
                    }
                    kept
                });
                if !is_queued {
                    record.pot_tracker().alloys_were_not_stored();
                }
            }
            *record.pot_curve() = curve;
            events.truncate(MAX_EVENTS);
            for event in &events {
                let text = describe(event);
                tracing::info!(device = record.name, text, "pot");
                let overheats = matches!(event, PotEvent::Overheats { .. });
                record.publish(EventKind::PotTemperature { text, overheats });
            }
        }));
    }
}

/// Publishes a change of the detected pot.
pub(super) fn publish_change(record: &DeviceRecord, pot: Pot) {
    let text = pot_change(pot).to_owned();
    tracing::info!(device = record.name, text, "pot");
    record.publish(EventKind::Pot {
        pot: format!("{pot:?}"),
        text,
    });
}
