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
        })
    }

    /// Reports to whoever watches.
    pub fn report(&mut self, progress: Progress<'_>) {
        (self.progress)(progress);
    }

    /// The truth of a window's half-cycle.
    pub fn truth_of(&self, window: &Window) -> Option<Truth> {
        self.truth.as_ref()?(window.half_cycle)
    }

    /// Asks for power and waits until it stays; returns the half-cycle since which it does.
    pub fn settle(&mut self, asked_w: u16) -> Result<u32, TrainerError> {
        self.client.set_power(asked_w)?;
        let mut steady = 0;
        let mut f_sw_hz = 0;
        for _ in 0..SETTLE_WITHIN {
            let Some(telemetry) = self.next_telemetry(asked_w)? else {
                continue;
            };
            self.report(Progress::Settling {
                asked_w,
                telemetry: &telemetry,
            });
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

    /// The next telemetry, `None` for another event; faults and silence are errors.
    fn next_telemetry(&mut self, asked_w: u16) -> Result<Option<Telemetry>, TrainerError> {
        let point = OperatingPoint::Heating { asked_w };
        match self.next_event("telemetry")? {
            Event::Telemetry(t) => {
                self.last = Some(t.clone());
                if t.fault != Fault::NONE {
                    return Err(TrainerError::Fault {
                        fault: t.fault,
                        point,
                    });
                }
                Ok(Some(t))
            }
            Event::Fault(f) if f.fault != Fault::NONE => Err(TrainerError::Fault {
                fault: f.fault,
                point,
            }),
            Event::Fault(_) | Event::Window(_) => Ok(None),
            Event::WindowRejected { seq, reason } => {
                self.report(Progress::Rejected {
                    seq,
                    why: &reason.to_string(),
                });
                Ok(None)
            }
        }
    }

    /// The next whole window that began after a half-cycle.
    pub fn window_after(
        &mut self,
        half_cycle: u32,
        point: OperatingPoint,
    ) -> Result<Box<Window>, TrainerError> {
        self.report(Progress::AwaitingWindow { point });
        let limit = PATIENCE_S * 100;
        for _ in 0..limit {
            match self.next_event("a window")? {
                Event::Window(window) if window.half_cycle > half_cycle => return Ok(window),
                Event::Window(_) => {}
                Event::WindowRejected { seq, reason } => {
                    self.report(Progress::Rejected {
                        seq,
                        why: &reason.to_string(),
                    });
                }
                Event::Telemetry(t) => self.last = Some(t),
                Event::Fault(f) if f.fault != Fault::NONE => {
                    return Err(TrainerError::Fault {
                        fault: f.fault,
                        point,
                    });
                }
                Event::Fault(_) => {}
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
