//! One watcher's look at all devices.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::ring::{Extent, heats};
use crate::board::now_ms;
use crate::face::Face;
use crate::model::{LiveDevice, LiveTelemetry};
use crate::states::live;
use crate::supervisor::Devices;
use crate::tank;

/// What one watcher has seen of the devices.
pub struct LiveTap {
    devices: Arc<Devices>,
    /// Half-cycles that were seen of each device.
    seen: BTreeMap<String, u64>,
    interval: Option<Duration>,
    taken: Instant,
}

impl LiveTap {
    /// From now on.
    pub(crate) fn new(devices: Arc<Devices>) -> Self {
        let faces = devices.all().into_iter().map(|handle| handle.face);
        let seen = faces.map(|face| (face.name.clone(), face.ring().came()));
        Self {
            seen: seen.collect(),
            devices,
            interval: None,
            taken: Instant::now(),
        }
    }

    /// The watcher means to ask this often, so that it is told how many times it did not.
    #[must_use]
    pub fn every(mut self, interval: Duration) -> Self {
        self.interval = Some(interval);
        self
    }

    /// What is new since it was asked last, or since the tap was made; never waits.
    pub fn take(&mut self) -> LiveTelemetry {
        let now = Instant::now();
        let skipped = skipped(self.interval, now.saturating_duration_since(self.taken));
        self.taken = now;
        let handles = self.devices.all();
        self.seen
            .retain(|name, _| handles.iter().any(|handle| handle.face.name == *name));
        let mut devices = BTreeMap::new();
        for handle in &handles {
            let face = &handle.face;
            let seen = self.seen.entry(face.name.clone()).or_insert(0);
            let (came, extent) = {
                let ring = face.ring();
                // A device of that name that was unplugged and plugged in again began anew.
                let before = if ring.came() < *seen { 0 } else { *seen };
                *seen = ring.came();
                (ring.came() - before, ring.since(before))
            };
            if came > 0
                && let Some(device) = device(face, came, skipped, &extent)
            {
                devices.insert(face.name.clone(), device);
            }
        }
        let at_ms = now_ms();
        LiveTelemetry { at_ms, devices }
    }
}

/// Intervals that passed without being taken.
fn skipped(interval: Option<Duration>, passed: Duration) -> u32 {
    let Some(interval) = interval.filter(|interval| !interval.is_zero()) else {
        return 0;
    };
    // Half an interval late is late, and nothing was skipped.
    let intervals = (passed.as_secs_f64() / interval.as_secs_f64()).round();
    (intervals as u32).saturating_sub(1)
}

/// What a device did; none where it has said nothing since it was found.
fn device(face: &Face, half_cycles: u64, skipped: u32, extent: &Extent) -> Option<LiveDevice> {
    let last = face.lock().last.clone()?;
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
        last: live(&last),
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
