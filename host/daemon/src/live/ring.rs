//! Last minute of a device's telemetry in buckets of 0.1 s.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_shared::wire::messages::{State, Telemetry};
use tokio::time::Instant;

/// Width of a bucket.
const BUCKET: Duration = Duration::from_millis(100);

/// Capacity in buckets: one minute of uninterrupted telemetry, some 50 kB.
const BUCKETS: usize = 600;

/// Minimum and maximum of a quantity.
pub type Extremes = [f64; 2];

/// Returns `true` if a half-cycle has R, L and a switching frequency.
pub fn heats(t: &Telemetry) -> bool {
    t.state == State::Heating && t.f_sw_hz > 0
}

fn widen(range: &mut Option<Extremes>, other: Extremes) {
    *range = Some(match range {
        None => other,
        Some([min, max]) => [min.min(other[0]), max.max(other[1])],
    });
}

/// Extremes of some half-cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extent {
    /// Power in watt; `None` if there is no half-cycle.
    pub power_w: Option<Extremes>,
    /// R in ohm; `None` if the hob did not heat.
    pub r_ohm: Option<Extremes>,
    /// L in henry; `None` if the hob did not heat.
    pub l_h: Option<Extremes>,
    /// Switching frequency in hertz; `None` if the hob did not heat.
    pub f_sw_hz: Option<Extremes>,
}

impl Extent {
    fn from_telemetry(t: &Telemetry) -> Self {
        let one = |x: f64| Some([x, x]);
        let heating = |x: f64| heats(t).then_some([x, x]);
        Self {
            power_w: one(f64::from(t.power_mw) * 1e-3),
            r_ohm: heating(t.r.ohm()),
            l_h: heating(t.l.henry()),
            f_sw_hz: heating(f64::from(t.f_sw_hz)),
        }
    }

    fn add(&mut self, other: &Self) {
        for (range, other) in [
            (&mut self.power_w, other.power_w),
            (&mut self.r_ohm, other.r_ohm),
            (&mut self.l_h, other.l_h),
            (&mut self.f_sw_hz, other.f_sw_hz),
        ] {
            if let Some(other) = other {
                widen(range, other);
            }
        }
    }
}

/// Extremes over a tenth of a second.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    began: Instant,
    /// Count of the ring's half-cycles at the end of the bucket.
    count_at_end: u64,
    extent: Extent,
}

/// Last minute of a device's telemetry.
#[derive(Debug, Default)]
pub struct LiveRing {
    buckets: VecDeque<Bucket>,
    /// Count of half-cycles since the ring was created.
    half_cycles: u64,
}

impl LiveRing {
    /// Adds a half-cycle received at `now`.
    pub fn push(&mut self, t: &Telemetry, now: Instant) {
        self.half_cycles += 1;
        let (extent, count_at_end) = (Extent::from_telemetry(t), self.half_cycles);
        match self.buckets.back_mut() {
            Some(last) if now.saturating_duration_since(last.began) < BUCKET => {
                last.extent.add(&extent);
                last.count_at_end = count_at_end;
            }
            _ => {
                if self.buckets.len() == BUCKETS {
                    self.buckets.pop_front();
                }
                let began = now;
                self.buckets.push_back(Bucket {
                    began,
                    count_at_end,
                    extent,
                });
            }
        }
    }

    /// Returns the count of half-cycles since the ring was created.
    pub fn half_cycles(&self) -> u64 {
        self.half_cycles
    }

    /// Returns the extremes of all but the first `seen` half-cycles, within the last minute, and of those that share a
    /// bucket with them.
    pub fn since(&self, seen: u64) -> Extent {
        let mut extent = Extent::default();
        let new = self.buckets.iter().rev();
        for bucket in new.take_while(|bucket| bucket.count_at_end > seen) {
            extent.add(&bucket.extent);
        }
        extent
    }

    /// Returns the number of buckets.
    #[cfg(test)]
    fn len(&self) -> usize {
        self.buckets.len()
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;

    use super::*;

    fn heating(power_w: u32) -> Telemetry {
        Telemetry {
            power_mw: power_w * 1_000,
            f_sw_hz: 45_000,
            ..telemetry(State::Heating)
        }
    }

    #[test]
    fn each_half_cycle_is_in_what_is_taken_next_and_memory_is_bounded() {
        let (mut ring, start) = (LiveRing::default(), Instant::now());
        // An hour at 100 half-cycles a second; one of them stands out.
        for k in 0..360_000u64 {
            let power_w = if k == 359_500 { 1_500 } else { 1_000 };
            ring.push(&heating(power_w), start + Duration::from_millis(10 * k));
        }
        assert_eq!((ring.half_cycles(), ring.len()), (360_000, BUCKETS));
        let taken = ring.since(359_500);
        assert_eq!(taken.power_w, Some([1_000.0, 1_500.0]));
        assert_eq!(ring.since(359_600).power_w, Some([1_000.0, 1_000.0]));
        assert_eq!(ring.since(360_000), Extent::default(), "nothing is new");
        // Whoever was too slow for all of it sees the last minute.
        assert_eq!(ring.since(0).power_w, Some([1_000.0, 1_500.0]));
    }

    #[test]
    fn what_does_not_heat_has_power_and_nothing_else() {
        let mut ring = LiveRing::default();
        let now = Instant::now();
        ring.push(&telemetry(State::Idle), now);
        ring.push(&telemetry(State::WaitingForPot), now);
        // Between two bursts of a low power.
        ring.push(&telemetry(State::Heating), now);
        let taken = ring.since(0);
        assert_eq!(taken.power_w, Some([0.0, 0.0]));
        assert_eq!((taken.r_ohm, taken.l_h, taken.f_sw_hz), (None, None, None));
        ring.push(&heating(900), now);
        let taken = ring.since(0);
        assert_eq!(taken.power_w, Some([0.0, 900.0]));
        assert_eq!(taken.f_sw_hz, Some([45_000.0, 45_000.0]));
        assert_eq!(taken.r_ohm, Some([1.0, 1.0]));
    }
}
