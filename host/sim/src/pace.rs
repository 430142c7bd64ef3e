//! Simulated time that follows wall time at a given speed, as far as the machine can.

use std::time::{Duration, Instant};

/// Wall time of lag beyond which it is dropped rather than caught up with.
const MAX_LAG: Duration = Duration::from_millis(500);

/// Period of reporting a lag.
const REPORT_PERIOD: Duration = Duration::from_secs(60);

/// Share of the time below which a lag is not reported.
const MIN_REPORTED: f64 = 0.01;

/// Target of simulated time.
#[derive(Clone, Debug)]
pub struct Pace {
    speed: f64,
    wall: Instant,
    simulated_s: f64,
    given_up: Duration,
    told: Instant,
}

impl Pace {
    /// Creates one: simulated time, now `t_s` seconds, passes `speed` times as fast as wall time.
    pub fn new(speed: f64, t_s: f64, now: Instant) -> Self {
        Self {
            speed,
            wall: now,
            simulated_s: t_s,
            given_up: Duration::ZERO,
            told: now,
        }
    }

    /// Target of simulated time in seconds, when it is `t_s`. A lag of more than half a second of wall time is dropped and counted.
    pub fn due_s(&mut self, t_s: f64, now: Instant) -> f64 {
        let due_s = self.at_s(now);
        let lag_s = (due_s - t_s) / self.speed;
        if lag_s <= MAX_LAG.as_secs_f64() {
            return due_s;
        }
        self.given_up += Duration::from_secs_f64(lag_s);
        (self.wall, self.simulated_s) = (now, t_s);
        t_s
    }

    fn at_s(&self, now: Instant) -> f64 {
        let passed = now.saturating_duration_since(self.wall);
        self.simulated_s + passed.as_secs_f64() * self.speed
    }

    /// Wall time until simulated time should be `t_s`.
    pub fn until(&self, t_s: f64, now: Instant) -> Duration {
        let early_s = (t_s - self.at_s(now)) / self.speed;
        Duration::try_from_secs_f64(early_s).unwrap_or_default()
    }

    /// Share of the last minute, from 0 to 1, dropped because the machine is too slow; once a minute, and only from 1 % on.
    pub fn lag(&mut self, now: Instant) -> Option<f64> {
        let passed = now.saturating_duration_since(self.told);
        if passed < REPORT_PERIOD {
            return None;
        }
        let share = self.given_up.as_secs_f64() / passed.as_secs_f64();
        (self.told, self.given_up) = (now, Duration::ZERO);
        (share >= MIN_REPORTED).then_some(share.min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn time_passes_as_many_times_faster_as_asked() {
        let start = Instant::now();
        let mut pace = Pace::new(20.0, 3.0, start);
        assert_eq!(pace.due_s(3.0, start + 100 * MS), 5.0);
        assert_eq!(pace.until(7.0, start + 100 * MS), 100 * MS);
        assert_eq!(pace.until(4.0, start + 100 * MS), Duration::ZERO);
    }

    #[test]
    fn what_cannot_be_caught_up_with_is_given_up_and_told_once_a_minute() {
        let start = Instant::now();
        let mut pace = Pace::new(2.0, 0.0, start);
        // A machine that simulates nothing at all.
        let mut told = Vec::new();
        for second in 1..=120u32 {
            let now = start + second * 1_000 * MS;
            assert_eq!(pace.due_s(0.0, now), 0.0);
            told.extend(pace.lag(now));
        }
        assert_eq!(told, [1.0, 1.0]);
        // And one that keeps up.
        let mut pace = Pace::new(2.0, 0.0, start);
        for second in 1..=60u32 {
            let now = start + second * 1_000 * MS;
            pace.due_s(2.0 * f64::from(second) - 0.1, now);
            assert_eq!(pace.lag(now), None);
        }
    }
}
