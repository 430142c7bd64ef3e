//! A device as the trainer uses it: power that settles, windows that count, a lookup that becomes
//! active.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_firmware::pwm;
use ihd_link::{Client, Counters, Event, HEARD_EVERY, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::{Outcome, State, Telemetry};
use ihd_signal::truth::Truth;

use super::{OperatingPoint, Progress, Recorded, TrainerError};

/// Half-cycles at one frequency after which it counts as settled.
pub const SETTLED_AFTER: u32 = 5;

/// How long an operating point may take to settle while it heats, on the device's clock.
pub const SETTLE_WITHIN: Duration = Duration::from_secs(6);

/// Half-cycles between two windows: a window of 57 kB takes 140 ms on a link of 400 kB/s.
pub const WINDOWS_EVERY: u8 = 20;

/// How long an event may take before ^C is looked at again.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Device time to wait for anything.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// Times that a command is sent which does the same when it comes twice.
const TRIES: usize = 3;

/// The truth of a half-cycle, counted as the device counts it, from whoever knows it; none where
/// nobody does, as on a real hob.
pub type TruthSource = Option<Box<dyn Fn(u32) -> Option<Truth>>>;

/// A device that is being trained on. Dropping it, in a panic too, switches off what it had asked for.
pub struct Device<'a> {
    /// None while the link is cut.
    client: Option<Client>,
    truth: TruthSource,
    progress: &'a mut dyn FnMut(Progress<'_>),
    stop: Option<&'a AtomicBool>,
    pub(super) last: Option<Telemetry>,
    /// Power that we have asked for and not taken back, in watt.
    asked_w: u16,
    /// When the device heard from us last, on its clock.
    heard: Duration,
    /// When it said something last.
    spoke: Duration,
    /// Half-cycles show the power that was asked for last: what they say is about it.
    is_asked: bool,
    /// The device waits, and whoever watches knows.
    is_waiting: bool,
    /// The recording's first failure.
    pub(super) not_recorded: Option<LinkError>,
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
        client: Client,
        truth: TruthSource,
        stop: Option<&'a AtomicBool>,
        progress: &'a mut dyn FnMut(Progress<'_>),
    ) -> Self {
        let now = client.clock();
        Self {
            client: Some(client),
            truth,
            progress,
            stop,
            last: None,
            asked_w: 0,
            heard: now,
            spoke: now,
            is_asked: false,
            is_waiting: false,
            not_recorded: None,
        }
    }

    /// Lets go of the device, whose link is cut.
    pub fn let_go(&mut self) {
        if let Some(mut client) = self.client.take() {
            // What was recorded until now is complete.
            if let Err(why) = client.finish_recording() {
                self.note_recording(why);
            }
        }
    }

    /// Takes the device again over a new link.
    pub fn take(&mut self, client: Client) {
        (self.heard, self.spoke) = (client.clock(), client.clock());
        self.client = Some(client);
        self.last = None;
    }

    /// The client.
    ///
    /// # Errors
    /// [`LinkError::Closed`] while the link is cut.
    pub fn client(&mut self) -> Result<&mut Client, TrainerError> {
        let closed = || LinkError::Closed {
            device: "the device".into(),
        };
        Ok(self.client.as_mut().ok_or_else(closed)?)
    }

    /// What the link has counted since it was made.
    pub fn counters(&self) -> Counters {
        self.client
            .as_ref()
            .map(Client::counters)
            .unwrap_or_default()
    }

    /// Sends what does the same when it comes twice, until it is answered.
    pub fn command<T>(
        &mut self,
        mut command: impl FnMut(&mut Client) -> Result<T, LinkError>,
    ) -> Result<T, TrainerError> {
        let mut tries = 1;
        loop {
            let client = self.client()?;
            match command(client) {
                Err(LinkError::NoAnswer { .. }) if tries < TRIES => tries += 1,
                answer => {
                    self.heard = client.clock();
                    return Ok(answer?);
                }
            }
        }
    }

    /// Starts telemetry and windows.
    pub fn stream(&mut self) -> Result<(), TrainerError> {
        self.command(|client| client.stream(1, WINDOWS_EVERY))
    }

    /// Asks for a power in watt.
    pub fn ask(&mut self, asked_w: u16) -> Result<(), TrainerError> {
        // Even where no answer comes: the command may have.
        self.asked_w = asked_w;
        self.is_asked = false;
        self.command(|client| client.set_power(asked_w))
    }

    /// Whether it is time to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
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

    /// Asks for power and waits until it stays; returns the half-cycle since which it does. Time in which
    /// the device waits does not count.
    pub fn settle(&mut self, asked_w: u16) -> Result<u32, TrainerError> {
        self.ask(asked_w)?;
        let point = OperatingPoint::Heating { asked_w };
        let mut steady = 0;
        let mut f_sw_hz = 0;
        let mut before = self.client()?.clock();
        let mut heated = Duration::ZERO;
        while heated < SETTLE_WITHIN {
            let Some(telemetry) = self.next_telemetry(point)? else {
                // Nothing else that a device sends stands for it.
                if self.client()?.clock().saturating_sub(before) >= PATIENCE {
                    return Err(self.silent("telemetry"));
                }
                continue;
            };
            let now = self.client()?.clock();
            let passed = now.saturating_sub(before);
            before = now;
            if self.heed(&telemetry, point)? == Heats::Later {
                steady = 0;
                continue;
            }
            heated += passed;
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
            seconds: SETTLE_WITHIN.as_secs(),
        })
    }

    /// The next telemetry, `None` for another event or none yet; silence is an error.
    fn next_telemetry(&mut self, point: OperatingPoint) -> Result<Option<Telemetry>, TrainerError> {
        match self.next_event("telemetry")? {
            Some(Event::Telemetry(t)) => Ok(Some(t)),
            Some(Event::Fault(f)) => self.note_fault(f.fault, point).map(|()| None),
            Some(Event::WindowRejected { seq, reason }) => {
                self.report(Progress::Rejected {
                    seq,
                    why: &reason.to_string(),
                });
                Ok(None)
            }
            Some(Event::Window(_) | Event::Log { .. }) | None => Ok(None),
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

    /// The next whole window that began after a half-cycle. Time in which the device waits does not count.
    pub fn window_after(
        &mut self,
        half_cycle: u32,
        point: OperatingPoint,
    ) -> Result<Box<Window>, TrainerError> {
        self.report(Progress::AwaitingWindow { point });
        let mut since = self.client()?.clock();
        loop {
            match self.next_event("a window")? {
                Some(Event::Window(window)) if window.half_cycle > half_cycle => return Ok(window),
                Some(Event::WindowRejected { seq, reason }) => {
                    self.report(Progress::Rejected {
                        seq,
                        why: &reason.to_string(),
                    });
                }
                Some(Event::Telemetry(t)) if self.heed(&t, point)? == Heats::Later => {
                    since = self.client()?.clock();
                }
                Some(Event::Fault(f)) => self.note_fault(f.fault, point)?,
                Some(Event::Telemetry(_) | Event::Window(_) | Event::Log { .. }) | None => {}
            }
            if self.client()?.clock().saturating_sub(since) >= PATIENCE {
                return Err(self.silent("a window"));
            }
        }
    }

    /// The window that the device records while a half-cycle is replayed to it: twice, because the
    /// zero crossing that begins the second run ends the first.
    pub fn replayed_window(&mut self, recorded: &Recorded) -> Result<Box<Window>, TrainerError> {
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
        let window = window?;
        ended?;
        Ok(window)
    }

    /// The next event, `None` where none has come yet. Keeps the device listening, and looks whether it is
    /// time to end.
    ///
    /// # Errors
    /// [`TrainerError::Interrupted`]; [`TrainerError::Silent`] where nothing has come for long.
    pub fn next_event(&mut self, what: &'static str) -> Result<Option<Event>, TrainerError> {
        if self.is_stopped() {
            return Err(TrainerError::Interrupted);
        }
        let event = match self.client()?.next_event(LOOK_EVERY) {
            Err(why @ LinkError::Recording(_)) => {
                self.note_recording(why);
                None
            }
            event => event?,
        };
        let now = self.client()?.clock();
        if now.saturating_sub(self.heard) >= HEARD_EVERY {
            self.command(|client| client.status())?;
        }
        if event.is_some() {
            self.spoke = now;
        } else if now.saturating_sub(self.spoke) >= PATIENCE {
            return Err(self.silent(what));
        }
        Ok(event)
    }

    /// The recording fails once; the hob does not wait for it.
    fn note_recording(&mut self, why: LinkError) {
        self.report(Progress::Note {
            text: &why.to_string(),
        });
        self.not_recorded.get_or_insert(why);
    }

    fn silent(&self, what: &'static str) -> TrainerError {
        let c = self.counters();
        TrainerError::Silent {
            what,
            seconds: PATIENCE.as_secs(),
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
    pub fn update_lookup(&mut self, lookup: &RlLookup) -> Result<(), TrainerError> {
        self.push(lookup)?;
        for _ in 0..20 {
            if self.command(|client| client.status())?.lookup_version == lookup.version {
                self.report(Progress::LookupActive {
                    version: lookup.version,
                    observed_cells: lookup.observed_cells(),
                });
                return Ok(());
            }
            // It waits for the half-cycle boundary: let one pass.
            match self.client()?.next_event(Duration::from_millis(20)) {
                Err(why @ LinkError::Recording(_)) => self.note_recording(why),
                event => drop(event?),
            }
        }
        Err(TrainerError::Lookup(format!(
            "the device accepted version {} but does not use it",
            lookup.version
        )))
    }

    /// Sent again where no answer came, a lookup that did arrive is not newer any more.
    fn push(&mut self, lookup: &RlLookup) -> Result<(), TrainerError> {
        let mut sent = 0;
        self.command(|client| {
            sent += 1;
            match client.push_lookup(lookup) {
                Err(LinkError::Refused {
                    outcome: Outcome::LookupStale | Outcome::Busy,
                    ..
                }) if sent > 1 => Ok(()),
                answer => answer,
            }
        })
    }

    /// Leaves the hob off, and the recording complete.
    pub fn finish(&mut self) -> Result<(), TrainerError> {
        self.ask(0)?;
        self.command(|client| client.stream(0, 0))
    }

    /// Ends the recording; its first failure.
    pub fn finish_recording(&mut self) -> Option<LinkError> {
        let ended = self
            .client
            .as_mut()
            .map_or(Ok(()), Client::finish_recording);
        self.not_recorded.take().or(ended.err())
    }
}

impl Drop for Device<'_> {
    fn drop(&mut self) {
        if self.asked_w > 0 {
            // Nobody is left to tell; the device switches off by itself when it hears nothing.
            let _ = self.finish();
        }
    }
}
