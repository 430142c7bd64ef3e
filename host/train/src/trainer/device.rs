//! A device as the trainer uses it: power that settles, windows that count, a lookup that becomes
//! active.

use std::time::Duration;

use ihd_firmware::pwm;
use ihd_link::{Client, Event, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::{State, Telemetry};
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;
use ihd_signal::truth::Truth;

use super::{OperatingPoint, Progress, Recorded, TrainerError};

/// Half-cycles at one frequency after which it counts as settled.
const SETTLED_AFTER: u32 = 5;

/// Half-cycles until an operating point must have settled: 6 s at 50 Hz.
const SETTLE_WITHIN: u32 = 600;

/// Half-cycles between two windows: a window of 57 kB takes 140 ms on a link of 400 kB/s.
const WINDOWS_EVERY: u8 = 20;

/// Half-cycles after which the device hears from us, whether we need anything or not: it switches
/// off when it does not.
const HEARD_EVERY: u32 = HOST_UNHEARD_HALF_CYCLES / 4;

/// Device time to wait for anything, in seconds.
const PATIENCE_S: u64 = 10;

/// The truth of a half-cycle, counted as the device counts it, from whoever knows it; none where
/// nobody does, as on a real hob.
pub type TruthSource = Option<Box<dyn Fn(u32) -> Option<Truth>>>;

/// A device that is being trained on.
pub struct Device<'a> {
    pub(super) client: Client,
    truth: TruthSource,
    progress: &'a mut dyn FnMut(Progress<'_>),
    pub(super) last: Option<Telemetry>,
    /// Half-cycles show the power that was asked for last: what they say is about it.
    is_asked: bool,
    /// The device waits, and whoever watches knows.
    is_waiting: bool,
}

/// What a half-cycle's state means to the trainer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Heats {
    /// It heats, or is about to.
    Yes,
    /// Not now, but it will by itself.
    Later,
}

impl<'a> Device<'a> {
    /// Starts the streams.
    pub fn start(
        mut client: Client,
        truth: TruthSource,
        progress: &'a mut dyn FnMut(Progress<'_>),
    ) -> Result<Self, TrainerError> {
        client.stream(1, WINDOWS_EVERY)?;
        Ok(Self {
            client,
            truth,
            progress,
            last: None,
            is_asked: false,
            is_waiting: false,
        })
    }

    /// What a half-cycle of an operating point says beside its numbers. Where the device only waits, this
    /// is reported once.
    fn heed(&mut self, t: &Telemetry, point: OperatingPoint) -> Result<Heats, TrainerError> {
        let seen_before = self.last.replace(t.clone());
        let Some(asked_w) = point.asked_w() else {
            return Ok(Heats::Yes);
        };
        self.is_asked |= t.asked_w == asked_w;
        match t.state {
            State::LockedOut => Err(TrainerError::Fault {
                fault: t.fault,
                point,
            }),
            State::WaitingForPot | State::Pausing => {
                if !self.is_waiting {
                    self.is_waiting = true;
                    self.report(Progress::Waiting {
                        asked_w,
                        telemetry: t,
                    });
                }
                Ok(Heats::Later)
            }
            // Half-cycles from before the power was asked for may still be on their way.
            State::Idle if self.is_asked && t.asked_w == 0 => Err(match seen_before {
                Some(Telemetry {
                    state: State::WaitingForPot,
                    pot,
                    ..
                }) => TrainerError::NoPot { pot, point },
                _ => TrainerError::SwitchedOff { point },
            }),
            State::Idle | State::Probing | State::Heating => {
                self.is_waiting = false;
                Ok(Heats::Yes)
            }
        }
    }

    /// Reports to whoever watches.
    pub fn report(&mut self, progress: Progress<'_>) {
        (self.progress)(progress);
    }

    /// The truth of a window's half-cycle.
    pub fn truth_of(&self, window: &Window) -> Option<Truth> {
        self.truth.as_ref()?(window.half_cycle)
    }

    /// Asks for power and waits until it stays; returns the half-cycle since which it does. Half-cycles
    /// in which the device waits do not count.
    pub fn settle(&mut self, asked_w: u16) -> Result<u32, TrainerError> {
        self.client.set_power(asked_w)?;
        self.is_asked = false;
        let point = OperatingPoint::Heating { asked_w };
        let mut steady = 0;
        let mut f_sw_hz = 0;
        let mut half_cycles = 0;
        while half_cycles < SETTLE_WITHIN {
            let Some(telemetry) = self.next_telemetry(point)? else {
                continue;
            };
            if self.heed(&telemetry, point)? == Heats::Later {
                steady = 0;
                continue;
            }
            half_cycles += 1;
            self.report(Progress::Settling {
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
            let at_limit = f_sw_hz <= pwm::LOWEST_HZ || f_sw_hz >= pwm::HIGHEST_HZ;
            // What the load cannot take ends at a limit of frequency, or at the resonance margin,
            // where the frequency stays and the power with it.
            if steady >= SETTLED_AFTER && (close || at_limit || steady >= 10 * SETTLED_AFTER) {
                return Ok(telemetry.half_cycle);
            }
        }
        Err(TrainerError::NotSettled {
            asked_w,
            last_w: self
                .last
                .as_ref()
                .map_or(0.0, |t| f64::from(t.power_mw) * 1e-3),
            f_sw_hz,
            half_cycles: SETTLE_WITHIN,
        })
    }

    /// The next telemetry, `None` for another event; silence is an error.
    fn next_telemetry(&mut self, point: OperatingPoint) -> Result<Option<Telemetry>, TrainerError> {
        match self.next_event("telemetry")? {
            Event::Telemetry(t) => Ok(Some(t)),
            Event::Fault(f) => self.note_fault(f.fault, point).map(|()| None),
            Event::Window(_) => Ok(None),
            Event::WindowRejected { seq, reason } => {
                self.report(Progress::Rejected {
                    seq,
                    why: &reason.to_string(),
                });
                Ok(None)
            }
        }
    }

    /// Heating begins again by itself after most faults, and the half-cycles' state says when not; a
    /// replay ends with any.
    fn note_fault(&self, fault: Fault, point: OperatingPoint) -> Result<(), TrainerError> {
        if fault != Fault::NONE && point.asked_w().is_none() {
            return Err(TrainerError::Fault { fault, point });
        }
        Ok(())
    }

    /// The next whole window that began after a half-cycle.
    pub fn window_after(
        &mut self,
        half_cycle: u32,
        point: OperatingPoint,
    ) -> Result<Box<Window>, TrainerError> {
        self.report(Progress::AwaitingWindow { point });
        let limit = PATIENCE_S * 100;
        let mut events = 0;
        while events < limit {
            events += 1;
            match self.next_event("a window")? {
                Event::Window(window) if window.half_cycle > half_cycle => return Ok(window),
                Event::Window(_) => {}
                Event::WindowRejected { seq, reason } => {
                    self.report(Progress::Rejected {
                        seq,
                        why: &reason.to_string(),
                    });
                }
                // What the device waits for does not count.
                Event::Telemetry(t) if self.heed(&t, point)? == Heats::Later => events = 0,
                Event::Telemetry(_) => {}
                Event::Fault(f) => self.note_fault(f.fault, point)?,
            }
        }
        Err(self.silent("a window"))
    }

    /// The window that the device records while a half-cycle is replayed to it: twice, because the
    /// zero crossing that begins the second run ends the first.
    pub fn replayed_window(&mut self, recorded: &Recorded) -> Result<Box<Window>, TrainerError> {
        let f_sw_hz = recorded.f_sw_hz;
        let (r, l) = prior().interpolate(f_sw_hz, 0);
        self.client.stream(0, 1)?;
        let mut replay = self.client.start_replay(f_sw_hz, r, l)?;
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
        let ended = self.client.continue_replay(taken).end();
        let window = window?;
        ended?;
        Ok(window)
    }

    fn next_event(&mut self, what: &'static str) -> Result<Event, TrainerError> {
        let event = self.client.next_event(Duration::from_secs(PATIENCE_S))?;
        if let Some(Event::Telemetry(t)) = &event
            && t.half_cycle.is_multiple_of(HEARD_EVERY)
        {
            self.client.status()?;
        }
        event.ok_or_else(|| self.silent(what))
    }

    fn silent(&self, what: &'static str) -> TrainerError {
        let c = self.client.counters();
        TrainerError::Silent {
            what,
            seconds: PATIENCE_S,
            windows: format!(
                "{} received, {} missing, {} rejected, {} dropped by the device",
                c.windows.received,
                c.windows.missing,
                c.windows_rejected_total(),
                c.windows.dropped_by_device
            ),
        }
    }

    /// Pushes a lookup and waits until the device reports it active.
    pub fn update_lookup(
        &mut self,
        lookup: &ihd_shared::lookup::RlLookup,
    ) -> Result<(), TrainerError> {
        self.client.push_lookup(lookup)?;
        for _ in 0..20 {
            if self.client.status()?.lookup_version == lookup.version {
                self.report(Progress::LookupActive {
                    version: lookup.version,
                    observed_cells: lookup.observed_cells(),
                });
                return Ok(());
            }
            // It waits for the half-cycle boundary: let one pass.
            self.client.next_event(Duration::from_millis(20))?;
        }
        Err(TrainerError::Lookup(format!(
            "the device accepted version {} but does not use it",
            lookup.version
        )))
    }

    /// Leaves the hob off.
    pub fn finish(&mut self) -> Result<(), LinkError> {
        self.client.set_power(0)?;
        self.client.stream(0, 0)
    }
}
