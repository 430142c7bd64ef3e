//! Sweep: sets one power after the other, waits until it has settled, takes a few windows, then switches off.
//!
//! ```text
//!  requested ──► settling ──► windows ──► next power … ──► off
//!                   │ after 6 s of heating: windows are taken unsettled, logged
//!                   │ no pot, or a pause after a trip: waits; the 6 s do not run
//!                   └ off at the panel, or locked out: the sweep ends
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use ihd_shared::wire::messages::{State, Telemetry};
use ihd_train::{SETTLE_WITHIN, Steadiness};
use tokio::time::Instant;

/// Windows at each power.
const WINDOWS_PER_POWER: u32 = 3;

/// Time limit for the windows at one power.
const WINDOWS_TIMEOUT: Duration = Duration::from_secs(5);

/// Limit of the heating time that one half-cycle adds, so that a gap in telemetry is not counted in full.
const MAX_HALF_CYCLE: Duration = Duration::from_millis(100);

/// Time limit until telemetry shows the requested power.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(2);

/// State of a sweep.
pub struct SweepState {
    left: VecDeque<u16>,
    asked_w: u16,
    phase: Phase,
}

enum Phase {
    /// The next power is due.
    Next,
    Settling(Settling),
    Windows {
        after: u32,
        received: u32,
        until: Instant,
    },
}

struct Settling {
    since: Instant,
    last: Instant,
    heating: Duration,
    /// `true` once telemetry has shown a requested power.
    is_shown: bool,
    is_waiting: bool,
    steadiness: Steadiness,
}

/// Action that a sweep requests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SweepStep {
    /// No action.
    Nothing,
    /// Set this power, in watt.
    SetPower(u16),
    /// Log this text.
    Log(String),
    /// Switch off: the last power is measured.
    Complete,
    /// Switch off: the sweep has ended earlier, for this reason.
    End(String),
}

impl SweepState {
    /// Creates a sweep through these powers, in watt.
    pub fn new(powers_w: &[u16]) -> Self {
        Self {
            left: powers_w.iter().copied().collect(),
            asked_w: 0,
            phase: Phase::Next,
        }
    }

    /// Returns the remaining powers in watt, the present one first.
    pub fn left_w(&self) -> Vec<u16> {
        let present = match self.phase {
            Phase::Next => None,
            _ => Some(self.asked_w),
        };
        present
            .into_iter()
            .chain(self.left.iter().copied())
            .collect()
    }

    /// Processes the time.
    pub fn tick(&mut self, now: Instant) -> SweepStep {
        match &self.phase {
            Phase::Next => self.next(now),
            Phase::Windows {
                until, received, ..
            } if now >= *until => {
                let (asked_w, received) = (self.asked_w, *received);
                self.phase = Phase::Next;
                SweepStep::Log(format!(
                    "sweep: {received} of {WINDOWS_PER_POWER} windows came at {asked_w} W; on to the next power"
                ))
            }
            _ => SweepStep::Nothing,
        }
    }

    fn next(&mut self, now: Instant) -> SweepStep {
        let Some(power_w) = self.left.pop_front() else {
            return SweepStep::Complete;
        };
        self.asked_w = power_w;
        self.phase = Phase::Settling(Settling {
            since: now,
            last: now,
            heating: Duration::ZERO,
            is_shown: false,
            is_waiting: false,
            steadiness: Steadiness::default(),
        });
        SweepStep::SetPower(power_w)
    }

    /// Takes what the device granted of the present power, in watt.
    pub fn take_granted(&mut self, granted_w: u16) {
        self.asked_w = granted_w;
    }

    /// Processes a window of this half-cycle.
    pub fn window(&mut self, half_cycle: u32) {
        if let Phase::Windows {
            after, received, ..
        } = &mut self.phase
            && half_cycle > *after
        {
            *received += 1;
            if *received >= WINDOWS_PER_POWER {
                self.phase = Phase::Next;
            }
        }
    }

    /// Processes a half-cycle.
    pub fn telemetry(&mut self, t: &Telemetry, now: Instant) -> SweepStep {
        if t.state == State::LockedOut {
            return SweepStep::End(format!("locked out: {}", t.fault.text()));
        }
        let asked_w = self.asked_w;
        let Phase::Settling(settling) = &mut self.phase else {
            return self.check_interruption(t);
        };
        settling.is_shown |= t.asked_w > 0;
        if settling.is_shown && t.state == State::Idle && t.asked_w == 0 {
            return SweepStep::End("switched off at the device".to_owned());
        }
        if !settling.is_shown && now.saturating_duration_since(settling.since) > RESPONSE_TIMEOUT {
            return SweepStep::End("the device took the power and does not show it".to_owned());
        }
        let (settled, message) = settling.update(t, asked_w, now);
        if settled {
            self.phase = Phase::Windows {
                after: t.half_cycle,
                received: 0,
                until: now + WINDOWS_TIMEOUT,
            };
        }
        message.map_or(SweepStep::Nothing, SweepStep::Log)
    }

    /// Checks, while waiting for windows, for switch-off at the panel and a lifted pot.
    fn check_interruption(&mut self, t: &Telemetry) -> SweepStep {
        if matches!(self.phase, Phase::Next) {
            return SweepStep::Nothing;
        }
        match t.state {
            State::Idle if t.asked_w == 0 => {
                SweepStep::End("switched off at the device".to_owned())
            }
            State::WaitingForPot | State::Pausing => {
                // The power must settle again.
                self.left.push_front(self.asked_w);
                self.phase = Phase::Next;
                SweepStep::Log(format!("sweep: {:?} at {} W", t.state, self.asked_w))
            }
            _ => SweepStep::Nothing,
        }
    }
}

impl Settling {
    /// Processes a half-cycle. Returns `true` if windows may be taken, and a text for the log.
    fn update(&mut self, t: &Telemetry, asked_w: u16, now: Instant) -> (bool, Option<String>) {
        let elapsed = now.saturating_duration_since(self.last);
        self.last = now;
        if matches!(t.state, State::WaitingForPot | State::Pausing) {
            let first = !std::mem::replace(&mut self.is_waiting, true);
            self.steadiness.reset();
            return (
                false,
                first.then(|| format!("sweep: {:?} at {asked_w} W", t.state)),
            );
        }
        self.is_waiting = false;
        self.heating += elapsed.min(MAX_HALF_CYCLE);
        if self.heating >= SETTLE_WITHIN {
            let power_w = t.power_mw / 1_000;
            return (
                true,
                Some(format!(
                    "sweep: {asked_w} W did not settle (last {power_w} W at {} Hz): windows are taken as it is",
                    t.f_sw_hz
                )),
            );
        }
        (self.steadiness.add(t, asked_w), None)
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;

    use super::*;

    const HALF_CYCLE: Duration = Duration::from_millis(10);

    struct Rig {
        sweep: SweepState,
        now: Instant,
        half_cycle: u32,
        asked: Vec<u16>,
        log: Vec<String>,
        end: Option<String>,
    }

    impl Rig {
        fn new(powers_w: &[u16]) -> Self {
            Self {
                sweep: SweepState::new(powers_w),
                now: Instant::now(),
                half_cycle: 0,
                asked: Vec::new(),
                log: Vec::new(),
                end: None,
            }
        }

        fn apply(&mut self, step: SweepStep) {
            match step {
                SweepStep::Nothing => {}
                SweepStep::SetPower(w) => self.asked.push(w),
                SweepStep::Log(text) => self.log.push(text),
                SweepStep::Complete => self.end = Some("done".to_owned()),
                SweepStep::End(why) => self.end = Some(why),
            }
        }

        /// Feeds half-cycles in `state`, at the requested power if heating.
        fn run(&mut self, half_cycles: u32, state: State, windows: bool) {
            for _ in 0..half_cycles {
                if self.end.is_some() {
                    return;
                }
                self.now += HALF_CYCLE;
                self.half_cycle += 1;
                let step = self.sweep.tick(self.now);
                self.apply(step);
                let mut t = telemetry(state);
                t.half_cycle = self.half_cycle;
                if state != State::Idle {
                    t.asked_w = self.asked.last().copied().unwrap_or(0);
                }
                if state == State::Heating {
                    t.f_sw_hz = 50_000;
                    t.power_mw = u32::from(t.asked_w) * 1_000;
                }
                let step = self.sweep.telemetry(&t, self.now);
                self.apply(step);
                if windows && self.half_cycle.is_multiple_of(20) {
                    self.sweep.window(self.half_cycle);
                }
            }
        }
    }

    #[test]
    fn every_power_is_asked_for_and_then_it_is_off() {
        let mut rig = Rig::new(&[700, 1_000]);
        assert_eq!(rig.sweep.left_w(), [700, 1_000]);
        rig.run(40, State::Heating, true);
        assert_eq!(rig.asked, [700]);
        assert_eq!(rig.sweep.left_w(), [700, 1_000]);
        rig.run(400, State::Heating, true);
        assert_eq!(rig.asked, [700, 1_000]);
        assert_eq!(rig.end.as_deref(), Some("done"));
        assert!(rig.log.is_empty(), "{:?}", rig.log);
    }

    #[test]
    fn a_lifted_pot_pauses_it_for_as_long_as_it_takes() {
        let mut rig = Rig::new(&[700]);
        rig.run(3, State::Heating, true);
        rig.run(6_000, State::WaitingForPot, true);
        assert_eq!((rig.end.clone(), rig.log.len()), (None, 1));
        rig.run(400, State::Heating, true);
        assert_eq!(rig.end.as_deref(), Some("done"));
    }

    #[test]
    fn a_pot_lifted_between_two_windows_is_settled_again() {
        let mut rig = Rig::new(&[700]);
        rig.run(30, State::Heating, true);
        rig.run(100, State::WaitingForPot, true);
        assert_eq!(rig.sweep.left_w(), [700]);
        rig.run(400, State::Heating, true);
        assert_eq!(
            (rig.asked, rig.end.as_deref()),
            (vec![700, 700], Some("done"))
        );
    }

    #[test]
    fn off_at_the_panel_ends_it() {
        let mut rig = Rig::new(&[700, 1_000]);
        rig.run(3, State::Heating, true);
        rig.run(1, State::Idle, true);
        assert_eq!(rig.end.as_deref(), Some("switched off at the device"));
        assert_eq!(rig.asked, [700]);
    }

    #[test]
    fn windows_that_do_not_come_do_not_hold_it_up_for_ever() {
        let mut rig = Rig::new(&[700]);
        rig.run(700, State::Heating, false);
        assert_eq!(rig.end.as_deref(), Some("done"));
        assert!(rig.log[0].contains("0 of 3 windows"), "{:?}", rig.log);
    }

    #[test]
    fn a_device_that_never_settles_is_taken_as_it_is() {
        let mut sweep = SweepState::new(&[700]);
        let mut now = Instant::now();
        assert_eq!(sweep.tick(now), SweepStep::SetPower(700));
        let mut log = Vec::new();
        for k in 0..700u32 {
            now += HALF_CYCLE;
            let mut t = telemetry(State::Heating);
            (t.asked_w, t.half_cycle, t.f_sw_hz) = (700, k, 40_000 + k);
            if let SweepStep::Log(text) = sweep.telemetry(&t, now) {
                log.push((k, text));
            }
        }
        assert_eq!(log.len(), 1);
        assert!((590..=610).contains(&log[0].0), "{log:?}");
    }
}
