//! Detection of suspend, rate limits, and back-off between attempts.

use std::time::Duration;

use tokio::time::Instant;

use crate::machine::Machine;

/// Delay beyond which the machine was suspended or this process stopped, not just busy.
const SUSPENDED: Duration = Duration::from_secs(5);

/// Detector of time in which this process did not run.
pub struct SuspendDetector {
    awake: Duration,
    elapsed: Duration,
}

impl SuspendDetector {
    /// Starts at the present time.
    pub fn new(machine: &Machine) -> Self {
        Self {
            awake: machine.awake(),
            elapsed: machine.elapsed(),
        }
    }

    /// Leaves out the time since the last comparison, in which this process worked or waited for its own work. A difference between the
    /// clocks in it still counts.
    pub fn leave_out_work(&mut self, machine: &Machine) {
        self.leave_out_until(machine.awake());
    }

    fn leave_out_until(&mut self, awake: Duration) {
        self.elapsed += awake.saturating_sub(self.awake);
        self.awake = awake;
    }

    /// Compares the clocks, to be called several times per second. Returns the time without running if it exceeds 5 s.
    pub fn poll(&mut self, machine: &Machine) -> Option<Duration> {
        self.poll_at(machine.awake(), machine.elapsed())
    }

    /// In suspend one clock stands still and the other goes on; for a stopped process both go on.
    fn poll_at(&mut self, awake: Duration, elapsed: Duration) -> Option<Duration> {
        let ran = awake.saturating_sub(self.awake);
        let passed = elapsed.saturating_sub(self.elapsed);
        (self.awake, self.elapsed) = (awake, elapsed);
        if ran >= SUSPENDED {
            return Some(ran.max(passed));
        }
        (passed.saturating_sub(ran) >= SUSPENDED).then_some(passed)
    }
}

/// Limit of events per second, with a count of the rejected ones.
pub struct RateLimit {
    per_second: u32,
    began: Instant,
    used: u32,
    rejected: u64,
}

impl RateLimit {
    /// Allows `per_second` events in each second.
    pub fn new(per_second: u32) -> Self {
        Self {
            per_second,
            began: Instant::now(),
            used: 0,
            rejected: 0,
        }
    }

    /// Counts an event. Returns `true` if it is within the limit.
    pub fn allow(&mut self) -> bool {
        self.allow_at(Instant::now())
    }

    fn allow_at(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.began) >= Duration::from_secs(1) {
            self.began = now;
            self.used = 0;
        }
        let allowed = self.used < self.per_second;
        match allowed {
            true => self.used += 1,
            false => self.rejected += 1,
        }
        allowed
    }

    /// Returns the number of rejected events since the last call.
    pub fn take_rejected(&mut self) -> u64 {
        std::mem::take(&mut self.rejected)
    }
}

/// Exponential back-off with jitter, so that devices do not retry at the same time.
pub struct Backoff {
    next: Duration,
    state: u64,
}

/// First wait.
const FIRST_WAIT: Duration = Duration::from_millis(200);
/// Longest wait, before jitter.
const MAX_WAIT: Duration = Duration::from_secs(5);

impl Backoff {
    /// Creates a back-off from a seed, so that a run is reproducible.
    pub fn new(seed: u64) -> Self {
        Self {
            next: FIRST_WAIT,
            state: seed,
        }
    }

    /// Returns the next wait: 0.2 s doubled each time up to 5 s, with ±25 % jitter.
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
        self.next = (2 * self.next).min(MAX_WAIT);
        wait
    }

    /// Resets the wait to the shortest, after success.
    pub fn reset(&mut self) {
        self.next = FIRST_WAIT;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time: Duration) -> SuspendDetector {
        SuspendDetector {
            awake: time,
            elapsed: time,
        }
    }

    #[test]
    fn suspend_and_stops_are_detected() {
        let s = Duration::from_secs;
        for (awake_s, elapsed_s, slept) in [
            (1, 1, None),
            (4, 4, None),
            (1, 51, Some(s(51))),
            (50, 50, Some(s(50))),
            (50, 0, Some(s(50))),
        ] {
            let found = at(s(100)).poll_at(s(100 + awake_s), s(100 + elapsed_s));
            assert_eq!(found, slept, "{awake_s} s awake of {elapsed_s} s");
        }
    }

    #[test]
    fn own_work_is_no_suspend_and_a_suspend_amid_it_is() {
        let s = Duration::from_secs;
        for (work_s, slept) in [(60, None), (90, Some(s(31)))] {
            let mut detector = at(s(100));
            // One minute of work, then a wait of a second.
            detector.leave_out_until(s(160));
            let found = detector.poll_at(s(161), s(100 + work_s + 1));
            assert_eq!(found, slept, "{work_s} s elapsed");
            assert_eq!(detector.poll_at(s(170), s(100 + work_s + 10)), Some(s(9)));
        }
    }

    #[test]
    fn what_is_beyond_the_allowance_is_counted() {
        let mut allowance = RateLimit::new(3);
        let now = Instant::now();
        let taken = (0..10).filter(|_| allowance.allow_at(now)).count();
        assert_eq!((taken, allowance.take_rejected()), (3, 7));
        assert!(allowance.allow_at(now + Duration::from_secs(1)));
        assert_eq!(allowance.take_rejected(), 0);
    }

    #[test]
    fn waits_grow_from_a_fifth_of_a_second_to_five() {
        let mut backoff = Backoff::new(1);
        let mut expected = FIRST_WAIT;
        for _ in 0..20 {
            let wait = backoff.wait();
            assert!(wait >= expected.mul_f64(0.749) && wait <= expected.mul_f64(1.251));
            expected = (2 * expected).min(MAX_WAIT);
        }
        let other: Vec<_> = (0..3).map(|_| Backoff::new(2).wait()).collect();
        assert_eq!(other[0], other[1], "the same seed waits the same");
        backoff.reset();
        assert!(backoff.wait() <= FIRST_WAIT.mul_f64(1.251));
        assert_ne!(Backoff::new(1).wait(), Backoff::new(2).wait());
    }
}
