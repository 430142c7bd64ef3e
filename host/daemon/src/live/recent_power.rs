//! Mean power over the last second of telemetry.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_shared::wire::messages::{State, Telemetry};
use tokio::time::Instant;

/// Time of the mean: one period of the bursts, in which most half-cycles of a low level have no power.
const MEAN_OF: Duration = Duration::from_secs(1);

/// Capacity in half-cycles: twice those of a second at 60 Hz.
const CAPACITY: usize = 240;

/// Power of each half-cycle of the last second, with its time of arrival.
#[derive(Clone, Debug, Default)]
pub struct RecentPower {
    half_cycles: VecDeque<(Instant, u32)>,
}

impl RecentPower {
    /// Adds a half-cycle received at `now`. One that does not heat ends the heating before it.
    pub fn push(&mut self, t: &Telemetry, now: Instant) {
        if !matches!(t.state, State::Heating | State::Probing) {
            self.half_cycles.clear();
        }
        let is_old = |(at, _): &(Instant, u32)| now.saturating_duration_since(*at) >= MEAN_OF;
        while self.half_cycles.len() == CAPACITY || self.half_cycles.front().is_some_and(is_old) {
            self.half_cycles.pop_front();
        }
        self.half_cycles.push_back((now, t.power_mw));
    }

    /// Returns the time of the last half-cycle; `None` without one.
    pub fn last_at(&self) -> Option<Instant> {
        self.half_cycles.back().map(|(at, _)| *at)
    }

    /// Returns the mean power in watt; 0 without telemetry.
    pub fn mean_w(&self) -> f64 {
        let sum_mw: f64 = self.half_cycles.iter().map(|(_, mw)| f64::from(*mw)).sum();
        sum_mw * 1e-3 / self.half_cycles.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;

    use super::*;

    /// 7 of 100 half-cycles at 1,500 W are 105 W, wherever in the second one looks.
    #[test]
    fn bursts_show_their_mean_at_each_moment() {
        let (mut power, began) = (RecentPower::default(), Instant::now());
        for k in 0..1_000u32 {
            let mut t = telemetry(State::Heating);
            t.power_mw = if k % 100 < 7 { 1_500_000 } else { 0 };
            power.push(&t, began + Duration::from_millis(10 * u64::from(k)));
            if k >= 100 {
                assert!((power.mean_w() - 105.0).abs() < 1e-9, "{}", power.mean_w());
            }
        }
    }

    /// The next heating begins at 0 W.
    #[test]
    fn power_ends_with_the_heating() {
        let (mut power, began) = (RecentPower::default(), Instant::now());
        let mut t = telemetry(State::Heating);
        t.power_mw = 1_500_000;
        power.push(&t, began);
        (t.state, t.power_mw) = (State::Idle, 0);
        power.push(&t, began + Duration::from_millis(10));
        assert_eq!(power.mean_w(), 0.0);
    }

    #[test]
    fn a_flood_is_bounded_and_silence_forgotten() {
        let (mut power, began) = (RecentPower::default(), Instant::now());
        let mut t = telemetry(State::Heating);
        t.power_mw = 900_000;
        assert_eq!(power.mean_w(), 0.0);
        (0..10_000).for_each(|_| power.push(&t, began));
        assert_eq!((power.half_cycles.len(), power.mean_w()), (CAPACITY, 900.0));
        t.power_mw = 0;
        power.push(&t, began + MEAN_OF);
        assert_eq!((power.half_cycles.len(), power.mean_w()), (1, 0.0));
    }
}
