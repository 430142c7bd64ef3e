//! Operating point of a device: waits until it is steady, and for the window that is recorded there.

use std::time::Duration;

use ihd_firmware::drive::pwm;
use ihd_link::{DeviceEvent, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::{State, Telemetry};

use super::{Device, TIMEOUT};
use crate::trainer::{OperatingPoint, RecordedHalfCycle, RunProgress, TrainerError};

/// Half-cycles at one frequency after which it counts as settled.
pub const SETTLED_AFTER: u32 = 5;

/// Longest time for an operating point to settle while it heats, in half-cycles of 50 Hz mains: the device's time, since a simulated hob
/// on a busy machine is slower than the host's clock.
pub const SETTLE_WITHIN: Duration = Duration::from_secs(6);

/// Half-cycle of 50 Hz mains.
const HALF_CYCLE: Duration = Duration::from_millis(10);

/// Heating state of a half-cycle.
#[derive(Clone, Copy, PartialEq, Eq)]
enum HeatingState {
    /// It heats, or is about to.
    Heats,
    /// It waits for a pot or pauses, and heats again by itself.
    Waits,
}

impl Device<'_> {
    /// Requests a power and waits until it is steady; returns the half-cycle in which it was found steady, and the power that the device
    /// took. Time in which the device waits for a pot does not count.
    pub fn settle(&mut self, asked_w: u16) -> Result<(u32, u16), TrainerError> {
        let asked_w = self.request_power(asked_w)?;
        let point = OperatingPoint::Heating { asked_w };
        let mut steady = 0;
        let mut f_sw_hz = 0;
        let mut last_telemetry = self.client()?.clock();
        let mut half_cycle = None;
        let mut heated = Duration::ZERO;
        while heated < SETTLE_WITHIN {
            let Some(telemetry) = self.next_telemetry(point)? else {
                // Other events do not replace telemetry.
                if self.client()?.clock().saturating_sub(last_telemetry) >= TIMEOUT {
                    return Err(self.silent("telemetry"));
                }
                continue;
            };
            last_telemetry = self.client()?.clock();
            let last = half_cycle.replace(telemetry.half_cycle);
            let passed = telemetry
                .half_cycle
                .saturating_sub(last.unwrap_or(telemetry.half_cycle));
            if self.check_telemetry(&telemetry, point)? == HeatingState::Waits {
                steady = 0;
                continue;
            }
            heated += HALF_CYCLE * passed;
            self.report(RunProgress::Settling {
                asked_w,
                telemetry: &telemetry,
            });
            // Between two bursts of a low power.
            if telemetry.state == State::Heating && telemetry.f_sw_hz == 0 {
                continue;
            }
            let same = telemetry.f_sw_hz == f_sw_hz && telemetry.state == State::Heating;
            steady = if same { steady + 1 } else { 0 };
            f_sw_hz = telemetry.f_sw_hz;
            let power_w = f64::from(telemetry.power_mw) * 1e-3;
            let close = (power_w / f64::from(asked_w) - 1.0).abs() < 0.05;
            let at_limit = f_sw_hz <= pwm::MIN_HZ || f_sw_hz >= pwm::MAX_HZ;
            // A power that the load cannot take ends at a limit of frequency or at the resonance margin: steady, but not close.
            if steady >= SETTLED_AFTER && (close || at_limit || steady >= 10 * SETTLED_AFTER) {
                return Ok((telemetry.half_cycle, asked_w));
            }
        }
        Err(TrainerError::NotSettled {
            asked_w,
            last_w: self
                .last
                .as_ref()
                .map_or(0.0, |t| f64::from(t.power_mw) * 1e-3),
            f_sw_hz,
            seconds: SETTLE_WITHIN.as_secs(),
        })
    }

    /// Returns the next telemetry, `None` for another event or none yet. Silence is an error.
    fn next_telemetry(&mut self, point: OperatingPoint) -> Result<Option<Telemetry>, TrainerError> {
        match self.next_event("telemetry")? {
            Some(DeviceEvent::Telemetry(t)) => Ok(Some(t)),
            Some(DeviceEvent::Fault(f)) => self.note_fault(f.fault, point).map(|()| None),
            Some(DeviceEvent::WindowRejected { seq, reason }) => {
                self.report(RunProgress::Rejected {
                    seq,
                    why: &reason.to_string(),
                });
                Ok(None)
            }
            Some(DeviceEvent::Window(_) | DeviceEvent::Log { .. }) | None => Ok(None),
        }
    }

    /// Handles a fault. While heating it is ignored: the device starts again by itself after most faults, and telemetry shows a lock-out.
    /// A replay ends with any fault.
    fn note_fault(&self, fault: Fault, point: OperatingPoint) -> Result<(), TrainerError> {
        if fault != Fault::NONE && point.asked_w().is_none() {
            return Err(TrainerError::Fault { fault, point });
        }
        Ok(())
    }

    /// Waits for the next complete window that began after a half-cycle. Time in which the device waits for a pot does not count.
    pub fn window_after(
        &mut self,
        half_cycle: u32,
        point: OperatingPoint,
    ) -> Result<Box<Window>, TrainerError> {
        self.report(RunProgress::AwaitingWindow { point });
        let mut since = self.client()?.clock();
        loop {
            match self.next_event("a window")? {
                Some(DeviceEvent::Window(window)) if window.half_cycle > half_cycle => {
                    return Ok(window);
                }
                Some(DeviceEvent::WindowRejected { seq, reason }) => {
                    self.report(RunProgress::Rejected {
                        seq,
                        why: &reason.to_string(),
                    });
                }
                Some(DeviceEvent::Telemetry(t))
                    if self.check_telemetry(&t, point)? == HeatingState::Waits =>
                {
                    since = self.client()?.clock();
                }
                Some(DeviceEvent::Fault(f)) => self.note_fault(f.fault, point)?,
                Some(
                    DeviceEvent::Telemetry(_) | DeviceEvent::Window(_) | DeviceEvent::Log { .. },
                )
                | None => {}
            }
            if self.client()?.clock().saturating_sub(since) >= TIMEOUT {
                return Err(self.silent("a window"));
            }
        }
    }

    /// Replays a half-cycle to the device and returns the window that it records. The half-cycle is sent twice: the zero crossing that
    /// begins the second run ends the first. The device takes the first pair for the crossing and the last one for the half-cycle's end:
    /// the window's times are the recording's.
    pub fn replayed_window(
        &mut self,
        recorded: &RecordedHalfCycle,
    ) -> Result<Box<Window>, TrainerError> {
        let f_sw_hz = recorded.f_sw_hz;
        let (r, l) = prior().interpolate(f_sw_hz, 0);
        let client = self.client()?;
        client.stream(0, 1)?;
        let mut replay = client.start_replay(f_sw_hz, r, l)?;
        let replayed = (0..2).try_for_each(|_| {
            let answer = replay.blocks(&recorded.pairs, Some(0), recorded.bus_dv);
            answer.map(drop)
        });
        let taken = replay.taken();
        // Entering replay mode has discarded any window under way: the next one is this.
        let point = OperatingPoint::Replayed { f_sw_hz };
        let window = replayed
            .map_err(TrainerError::from)
            .and_then(|()| self.window_after(0, point));
        // Even after a failure: the device must not stay in replay mode.
        let ended = self.client()?.continue_replay(taken).end();
        let mut window = window?;
        ended?;
        window.first_pair_ns = window.first_pair_ns.saturating_add(recorded.first_pair_ns);
        window.first_trajectory_ns = window
            .first_trajectory_ns
            .saturating_add(recorded.first_pair_ns);
        window.half_cycle_ns = recorded.half_cycle_ns;
        Ok(window)
    }

    /// Checks the state in a half-cycle's telemetry: locked out, without pot and switched off are errors. A device that waits is reported
    /// once for each reason.
    fn check_telemetry(
        &mut self,
        t: &Telemetry,
        point: OperatingPoint,
    ) -> Result<HeatingState, TrainerError> {
        let seen_before = self.last.replace(t.clone());
        let Some(asked_w) = point.asked_w() else {
            return Ok(HeatingState::Heats);
        };
        self.is_confirmed |= t.asked_w == asked_w;
        match t.state {
            State::LockedOut => Err(TrainerError::Fault {
                fault: t.fault,
                point,
            }),
            State::WaitingForPot | State::Pausing => {
                let reason = Some((t.state, t.pot, t.fault));
                if self.waits_for != reason {
                    self.waits_for = reason;
                    self.report(RunProgress::Waiting {
                        asked_w,
                        telemetry: t,
                    });
                }
                Ok(HeatingState::Waits)
            }
            // Half-cycles from before the power was asked for may still be on their way.
            State::Idle if self.is_confirmed && t.asked_w == 0 => Err(match seen_before {
                Some(Telemetry {
                    state: State::WaitingForPot,
                    pot,
                    ..
                }) => TrainerError::NoPot { pot, point },
                _ => TrainerError::SwitchedOff { point },
            }),
            State::Idle | State::Probing | State::Heating => {
                self.waits_for = None;
                Ok(HeatingState::Heats)
            }
        }
    }
}
