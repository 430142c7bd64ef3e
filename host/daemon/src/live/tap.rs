//! One reader's view of the live telemetry of all devices.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ihd_model::{LiveDevice, LiveTelemetry};
use tokio::time::Instant;

use super::ring::{Extent, heats};
use crate::device_record::DeviceRecord;
use crate::machine::Machine;
use crate::supervisor::Devices;
use crate::tank;

/// Tap of the live telemetry for one reader.
pub struct LiveTap {
    devices: Arc<Devices>,
    machine: Machine,
    /// Count of half-cycles at the last poll, by device.
    seen: BTreeMap<String, u64>,
    interval: Option<Duration>,
    last_poll: Instant,
}

impl LiveTap {
    /// Creates a tap of telemetry from now on.
    pub(crate) fn new(devices: Arc<Devices>, machine: Machine) -> Self {
        let records = devices.all().into_iter().map(|handle| handle.record);
        let seen = records.map(|record| (record.name.clone(), record.ring().half_cycles()));
        Self {
            seen: seen.collect(),
            devices,
            machine,
            interval: None,
            last_poll: Instant::now(),
        }
    }

    /// Sets the reader's polling interval, from which [`LiveTap::take`] counts skipped polls.
    #[must_use]
    pub fn every(mut self, interval: Duration) -> Self {
        self.interval = Some(interval);
        self
    }

    /// Returns the extremes since the last poll or the creation of the tap; never waits.
    pub fn take(&mut self) -> LiveTelemetry {
        let now = Instant::now();
        let skipped = skipped(self.interval, now.saturating_duration_since(self.last_poll));
        self.last_poll = now;
        let handles = self.devices.all();
        self.seen
            .retain(|name, _| handles.iter().any(|handle| handle.record.name == *name));
        let mut devices = BTreeMap::new();
        for handle in &handles {
            let record = &handle.record;
            let seen = self.seen.entry(record.name.clone()).or_insert(0);
            let (half_cycles, extent) = {
                let ring = record.ring();
                // The count of a board that was unplugged and plugged in again restarts.
                let before = if ring.half_cycles() < *seen { 0 } else { *seen };
                *seen = ring.half_cycles();
                (ring.half_cycles() - before, ring.since(before))
            };
            if half_cycles > 0
                && let Some(device) = device(record, half_cycles, skipped, &extent)
            {
                devices.insert(record.name.clone(), device);
            }
        }
        LiveTelemetry {
            at_ms: self.machine.now_ms(),
            devices,
        }
    }
}

/// Returns the number of intervals without a poll.
fn skipped(interval: Option<Duration>, passed: Duration) -> u32 {
    let Some(interval) = interval.filter(|interval| !interval.is_zero()) else {
        return 0;
    };
    // A poll late by up to half an interval skips none.
    let intervals = (passed.as_secs_f64() / interval.as_secs_f64()).round();
    (intervals as u32).saturating_sub(1)
}

/// Returns the report of a device; `None` before its first telemetry.
fn device(
    record: &DeviceRecord,
    half_cycles: u64,
    skipped: u32,
    extent: &Extent,
) -> Option<LiveDevice> {
    let (last, live) = {
        let inner = record.lock();
        (inner.last.clone()?, inner.live()?)
    };
    let (r_ohm, l_h, f_sw_hz) = (last.r.ohm(), last.l.henry(), f64::from(last.f_sw_hz));
    let heats = heats(&last);
    Some(LiveDevice {
        half_cycles,
        skipped,
        phase_deg: tank::phase_deg(r_ohm, l_h, f_sw_hz).filter(|_| heats),
        resonance_hz: tank::resonance_hz(l_h).filter(|_| heats),
        power_w: extent.power_w?,
        r_ohm: extent.r_ohm,
        l_h: extent.l_h,
        f_sw_hz: extent.f_sw_hz,
        last: live,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_that_was_not_asked_in_is_counted() {
        let (ms, every) = (Duration::from_millis, Some(Duration::from_millis(200)));
        for (passed_ms, expected) in [(0, 0), (190, 0), (290, 0), (310, 1), (1_000, 4)] {
            assert_eq!(skipped(every, ms(passed_ms)), expected, "{passed_ms} ms");
        }
        assert_eq!(skipped(None, ms(9_000)), 0);
        assert_eq!(skipped(Some(Duration::ZERO), ms(9_000)), 0);
    }
}
