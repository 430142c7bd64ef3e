//! The last minute of a device in buckets of 0.1 s.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_shared::wire::messages::{State, Telemetry};
use tokio::time::Instant;

/// Width of a bucket.
const BUCKET: Duration = Duration::from_millis(100);

/// Buckets that are kept: a minute of a device that speaks without a pause, some 50 kB.
const BUCKETS: usize = 600;

/// The least and the largest of a quantity.
pub type Extremes = [f64; 2];

/// Whether R, L and a switching frequency can be told from a half-cycle.
pub fn heats(t: &Telemetry) -> bool {
    t.state == State::Heating && t.f_sw_hz > 0
}

fn widen(have: &mut Option<Extremes>, with: Extremes) {
    *have = Some(match have {
        None => with,
        Some([least, largest]) => [least.min(with[0]), largest.max(with[1])],
    });
}

/// Extremes of some half-cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extent {
    /// Of the power, in watt.
    pub power_w: Option<Extremes>,
    /// Of R, in ohm; none where it did not heat.
    pub r_ohm: Option<Extremes>,
    /// Of L, in henry; none where it did not heat.
    pub l_h: Option<Extremes>,
    /// Of the switching frequency, in hertz; none where it did not heat.
    pub f_sw_hz: Option<Extremes>,
}

impl Extent {
    fn of(t: &Telemetry) -> Self {
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
        for (have, with) in [
            (&mut self.power_w, other.power_w),
            (&mut self.r_ohm, other.r_ohm),
            (&mut self.l_h, other.l_h),
            (&mut self.f_sw_hz, other.f_sw_hz),
        ] {
            if let Some(with) = with {
                widen(have, with);
            }
        }
    }
}

/// Half-cycles of a tenth of a second.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    began: Instant,
    /// Half-cycles that came until its end, since the ring began.
    until: u64,
    extent: Extent,
}

/// The last minute of a device.
#[derive(Debug, Default)]
pub struct LiveRing {
    buckets: VecDeque<Bucket>,
    /// Half-cycles that came since the ring began.
    came: u64,
}

impl LiveRing {
    /// A half-cycle came.
    pub fn push(&mut self, t: &Telemetry, now: Instant) {
        self.came += 1;
        let (extent, until) = (Extent::of(t), self.came);
        match self.buckets.back_mut() {
            Some(last) if now.saturating_duration_since(last.began) < BUCKET => {
                last.extent.add(&extent);
                last.until = until;
            }
            _ => {
                if self.buckets.len() == BUCKETS {
                    self.buckets.pop_front();
                }
                let began = now;
                self.buckets.push_back(Bucket {
                    began,
                    until,
                    extent,
                });
            }
        }
    }

    /// Half-cycles that came since the ring began.
    pub fn came(&self) -> u64 {
        self.came
    }

    /// Extremes of all but the first `seen` half-cycles, as far as they are kept, and of those that share a bucket
    /// with them.
    pub fn since(&self, seen: u64) -> Extent {
        let mut extent = Extent::default();
        let new = self.buckets.iter().rev();
        for bucket in new.take_while(|bucket| bucket.until > seen) {
            extent.add(&bucket.extent);
        }
        extent
    }

    /// Buckets that are held.
    #[cfg(test)]
    fn len(&self) -> usize {
        self.buckets.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::states::tests::telemetry;

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
        assert_eq!((ring.came(), ring.len()), (360_000, BUCKETS));
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
