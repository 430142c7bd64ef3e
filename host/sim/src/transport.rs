//! Simulated hob as a device in this process. [`SharedHob`]: simulated time passes only while the host waits for bytes, so a run
//! gives the same numbers on any machine. [`PacedHob`]: simulated time follows wall time, also between accesses.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::{LinkError, Transport};
use ihd_signal::truth::Truth;

use super::hob::SimHob;
use super::pace::Pace;
use super::recent_truths::RecentTruths;

/// Hob shared by the host's transport and readers of its truth.
#[derive(Clone)]
pub struct SharedHob {
    hob: Arc<Mutex<SimHob>>,
    truths: RecentTruths,
}

impl SharedHob {
    /// Shares a hob.
    pub fn new(hob: SimHob) -> Self {
        Self {
            truths: hob.truths().clone(),
            hob: Arc::new(Mutex::new(hob)),
        }
    }

    /// Locks the hob. Poisoning is ignored: every step leaves a complete state.
    pub fn lock(&self) -> MutexGuard<'_, SimHob> {
        self.hob.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SharedHob {
    /// Truth of one of the last half-cycles, numbered like the firmware's. Does not wait for the simulation.
    pub fn truth(&self, half_cycle: u32) -> Option<Truth> {
        self.truths.get(half_cycle)
    }
}

impl Transport for SharedHob {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.lock().send(bytes);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let mut hob = self.lock();
        let deadline_s = hob.t_s() + timeout.as_secs_f64();
        loop {
            let n = hob.receive(buf);
            if n > 0 || hob.t_s() >= deadline_s {
                return Ok(n);
            }
            hob.step();
        }
    }

    fn clock(&self) -> Duration {
        Duration::from_secs_f64(self.lock().t_s())
    }

    fn describe(&self) -> String {
        "sim".to_owned()
    }
}

/// Longest time that is simulated, or slept, before bytes are checked again.
const SLICE: Duration = Duration::from_millis(2);

/// Hob whose simulated time follows wall time at a given speed, without a thread of its own: the time since the last access, up to
/// half a second, is simulated at the next one. Its clock is simulated time.
pub struct PacedHob {
    hob: SharedHob,
    pace: Pace,
}

impl PacedHob {
    /// Creates one from a hob's present time on, `speed` times as fast as wall time, or as fast as the machine can. The hob may be
    /// that of an earlier connection that is over.
    pub fn new(hob: SharedHob, speed: f64) -> Self {
        let t_s = {
            let mut hob = hob.lock();
            hob.bound_link();
            // Waiting bytes belong to the earlier host.
            while hob.receive(&mut [0; 4096]) > 0 {}
            hob.t_s()
        };
        Self {
            pace: Pace::new(speed, t_s, Instant::now()),
            hob,
        }
    }

    /// Simulates up to the target time, to `deadline_s` or to the first byte; returns `false` if it stopped earlier, after a slice
    /// of wall time.
    fn catch_up(&mut self, deadline_s: f64) -> bool {
        let began = Instant::now();
        let mut hob = self.hob.lock();
        let due_s = self.pace.due_s(hob.t_s(), began).min(deadline_s);
        while hob.t_s() < due_s && hob.waiting() == 0 {
            if began.elapsed() >= SLICE {
                return false;
            }
            hob.step();
        }
        true
    }
}

impl Transport for PacedHob {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.hob.send(bytes)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        // A zero timeout also simulates a slice: otherwise time would never pass.
        let deadline_s = self.clock().as_secs_f64() + timeout.max(SLICE).as_secs_f64();
        loop {
            let there = self.catch_up(deadline_s);
            let (n, t_s) = {
                let mut hob = self.hob.lock();
                (hob.receive(buf), hob.t_s())
            };
            if n > 0 || t_s >= deadline_s || timeout.is_zero() {
                return Ok(n);
            }
            if there {
                let early = self.pace.until(deadline_s, Instant::now());
                thread::sleep(early.clamp(Duration::from_micros(100), SLICE));
            }
        }
    }

    fn clock(&self) -> Duration {
        self.hob.clock()
    }

    fn describe(&self) -> String {
        self.hob.describe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hob::HobConfig;

    fn paced(speed: f64) -> (PacedHob, SharedHob) {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        (PacedHob::new(hob.clone(), speed), hob)
    }

    #[test]
    fn a_silent_hob_takes_the_time_that_is_waited() {
        // A tenth of real time, which any machine keeps up with.
        let (mut paced, _) = paced(0.1);
        let (wall, began) = (Instant::now(), paced.clock());
        assert_eq!(
            paced
                .receive(&mut [0; 64], Duration::from_millis(30))
                .unwrap(),
            0
        );
        let (passed, simulated) = (wall.elapsed(), paced.clock() - began);
        assert!(passed >= Duration::from_millis(290), "{passed:?}");
        assert!(simulated >= Duration::from_millis(30), "{simulated:?}");
        assert!(
            simulated <= passed / 10 + Duration::from_millis(2),
            "{simulated:?} in {passed:?}"
        );
    }

    #[test]
    fn what_nobody_waited_for_is_caught_up_with_but_not_beyond_half_a_second() {
        let (mut paced, _) = paced(0.1);
        let look = |paced: &mut PacedHob| {
            let before = paced.clock();
            for _ in 0..200 {
                paced.receive(&mut [0; 64], Duration::ZERO).unwrap();
            }
            paced.clock() - before
        };
        thread::sleep(Duration::from_millis(300));
        let caught_up = look(&mut paced);
        assert!(caught_up >= Duration::from_millis(30), "{caught_up:?}");
        thread::sleep(Duration::from_millis(700));
        let given_up = look(&mut paced);
        assert!(given_up < Duration::from_millis(50), "{given_up:?}");
    }

    #[test]
    fn a_host_shakes_hands_and_gets_windows_and_an_unread_link_is_bounded() {
        let (paced, hob) = paced(1.0);
        hob.lock()
            .panel(ihd_firmware::control::request::PanelEvent::Level(5));
        let mut client = ihd_link::Client::connect(Box::new(paced)).unwrap();
        client.stream(1, 10).unwrap();
        let deadline = Instant::now() + Duration::from_secs(600);
        loop {
            assert!(Instant::now() < deadline, "no window");
            if let Some(ihd_link::DeviceEvent::Window(_)) =
                client.next_event(Duration::from_millis(100)).unwrap()
            {
                break;
            }
        }
        // Nobody fetches for a second of simulated time, in which the link carries 400 kB.
        let mut hob = hob.lock();
        let until_s = hob.t_s() + 1.0;
        while hob.t_s() < until_s {
            hob.step();
        }
        assert!(hob.waiting() <= 66 * 1024, "{} bytes wait", hob.waiting());
    }
}
