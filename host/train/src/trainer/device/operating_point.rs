//! Operating point of a device: waits until it is steady, and for the window that is recorded there.

use std::time::Duration;

use ihd_link::{DeviceEvent, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::{State, Telemetry};

use super::{Device, TIMEOUT};
use crate::trainer::steadiness::{SETTLE_WITHIN, Steadiness};
use crate::trainer::{OperatingPoint, RecordedHalfCycle, RunProgress, TrainerError};

/// Heating time that a half-cycle counts for: the device's time, since a simulated hob on a busy machine is slower than the host's clock.
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
        let mut steadiness = Steadiness::default();
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
                steadiness.reset();
                continue;
            }
            heated += HALF_CYCLE * passed;
            self.report(RunProgress::Settling {
                asked_w,
                telemetry: &telemetry,
            });
            if steadiness.add(&telemetry, asked_w) {
                return Ok((telemetry.half_cycle, asked_w));
            }
        }
        let last = self.last.as_ref();
        Err(TrainerError::NotSettled {
            asked_w,
            last_w: last.map_or(0.0, |t| f64::from(t.power_mw) * 1e-3),
            f_sw_hz: last.map_or(0, |t| t.f_sw_hz),
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

    /// Waits for the next complete window that began after a half-cycle: for ten seconds of heating by the device's half-cycles, or of the
    /// link's clock in a replay, which has no telemetry.
    pub fn window_after(
        &mut self,
        half_cycle: u32,
        point: OperatingPoint,
    ) -> Result<Box<Window>, TrainerError> {
        self.report(RunProgress::AwaitingWindow { point });
        let begin = self.client()?.clock();
        let mut heats_since = None;
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
                Some(DeviceEvent::Telemetry(t)) => match self.check_telemetry(&t, point)? {
                    HeatingState::Waits => heats_since = None,
                    HeatingState::Heats => {
                        let since = *heats_since.get_or_insert(t.half_cycle);
                        if HALF_CYCLE * t.half_cycle.saturating_sub(since) >= TIMEOUT {
                            return Err(self.silent("a window"));
                        }
                    }
                },
                Some(DeviceEvent::Fault(f)) => self.note_fault(f.fault, point)?,
                Some(DeviceEvent::Window(_) | DeviceEvent::Log { .. }) | None => {}
            }
            let waited = self.client()?.clock().saturating_sub(begin);
            if point.asked_w().is_none() && waited >= TIMEOUT {
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
