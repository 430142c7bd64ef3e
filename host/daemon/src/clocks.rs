//! Whether this machine was asleep, and when to try again.

use std::time::Duration;

use tokio::time::Instant;

use crate::machine::Machine;

/// A turn that comes this late was not merely busy: the machine slept, or this process was stopped.
const SLEPT: Duration = Duration::from_secs(5);

/// Watches the clocks for time in which nothing ran.
pub struct Clocks {
    uptime: Duration,
    wall_ms: i64,
}

impl Clocks {
    /// From now on.
    pub fn new(machine: &Machine) -> Self {
        Self {
            uptime: machine.uptime(),
            wall_ms: machine.now_ms(),
        }
    }

    /// To be called many times a second; how long nothing ran, where that was long.
    pub fn turn(&mut self, machine: &Machine) -> Option<Duration> {
        self.turn_at(machine.uptime(), machine.now_ms())
    }

    /// The clock that counts turns stands still while most machines sleep, the wall's goes on; that of a
    /// process that was stopped goes on as well.
    fn turn_at(&mut self, uptime: Duration, wall_ms: i64) -> Option<Duration> {
        let awake = uptime.saturating_sub(self.uptime);
        let passed_ms = wall_ms.saturating_sub(self.wall_ms).max(0);
        let passed = Duration::from_millis(passed_ms.unsigned_abs());
        (self.uptime, self.wall_ms) = (uptime, wall_ms);
        if awake >= SLEPT {
            return Some(awake.max(passed));
        }
        (passed.saturating_sub(awake) >= SLEPT).then_some(passed)
    }
}

/// So many a second, and what is beyond that is counted.
pub struct Allowance {
    a_second: u32,
    began: Instant,
    used: u32,
    beyond: u64,
}

impl Allowance {
    /// `a_second` of them.
    pub fn new(a_second: u32) -> Self {
        Self {
            a_second,
            began: Instant::now(),
            used: 0,
            beyond: 0,
        }
    }

    /// Whether one more is allowed.
    pub fn take(&mut self) -> bool {
        self.take_at(Instant::now())
    }

    fn take_at(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.began) >= Duration::from_secs(1) {
            self.began = now;
            self.used = 0;
        }
        let allowed = self.used < self.a_second;
        match allowed {
            true => self.used += 1,
            false => self.beyond += 1,
        }
        allowed
    }

    /// How many were beyond it since this was asked last.
    pub fn take_beyond(&mut self) -> u64 {
        std::mem::take(&mut self.beyond)
    }
}

/// Waits between two tries: longer each time, and not at the same time for every device.
pub struct Backoff {
    next: Duration,
    state: u64,
}

const SHORTEST: Duration = Duration::from_millis(200);
const LONGEST: Duration = Duration::from_secs(5);

impl Backoff {
    /// From a seed, so that a run can be repeated.
    pub fn new(seed: u64) -> Self {
        Self {
            next: SHORTEST,
            state: seed,
        }
    }

    /// The next wait: 75 to 125 % of 0.2 s doubled each time, up to 5 s.
    pub fn wait(&mut self) -> Duration {
        // splitmix64.
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        let wait = self
            .next
            .mul_f64(0.75 + 0.5 * (z >> 11) as f64 / (1u64 << 53) as f64);
        self.next = (2 * self.next).min(LONGEST);
        wait
    }

    /// It went well: the next wait is short again.
    pub fn reset(&mut self) {
        self.next = SHORTEST;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleep_and_stops_are_seen_and_a_clock_that_is_set_back_is_not() {
        let s = Duration::from_secs;
        let at = |uptime| Clocks { uptime, wall_ms: 0 };
        for (awake_s, wall_s, slept) in [
            (1, 1, None),
            (4, 4, None),
            (1, 51, Some(s(51))),
            (50, 50, Some(s(50))),
            (50, 0, Some(s(50))),
            (1, -3_600, None),
        ] {
            let mut clocks = at(s(100));
            let turn = clocks.turn_at(s(100 + awake_s), 1_000 * wall_s);
            assert_eq!(turn, slept, "{awake_s} s awake, {wall_s} s by the wall");
        }
    }

    #[test]
    fn what_is_beyond_the_allowance_is_counted() {
        let mut allowance = Allowance::new(3);
        let now = Instant::now();
        let taken = (0..10).filter(|_| allowance.take_at(now)).count();
        assert_eq!((taken, allowance.take_beyond()), (3, 7));
        assert!(allowance.take_at(now + Duration::from_secs(1)));
        assert_eq!(allowance.take_beyond(), 0);
    }

    #[test]
    fn waits_grow_from_a_fifth_of_a_second_to_five() {
        let mut backoff = Backoff::new(1);
        let mut expected = SHORTEST;
        for _ in 0..20 {
            let wait = backoff.wait();
            assert!(wait >= expected.mul_f64(0.749) && wait <= expected.mul_f64(1.251));
            expected = (2 * expected).min(LONGEST);
        }
        let other: Vec<_> = (0..3).map(|_| Backoff::new(2).wait()).collect();
        assert_eq!(other[0], other[1], "the same seed waits the same");
        backoff.reset();
        assert!(backoff.wait() <= SHORTEST.mul_f64(1.251));
        assert_ne!(Backoff::new(1).wait(), Backoff::new(2).wait());
    }
}
