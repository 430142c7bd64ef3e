//! Device of a training run: sets a power and waits until it is steady, receives windows, pushes a lookup.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_firmware::drive::pwm;
use ihd_link::{Client, ClientCounters, DeviceEvent, KEEPALIVE_PERIOD, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::{Outcome, State, Telemetry};
use ihd_signal::truth::Truth;

use super::{OperatingPoint, RecordedHalfCycle, RunProgress, TrainerError};

/// Half-cycles at one frequency after which it counts as settled.
pub const SETTLED_AFTER: u32 = 5;

/// Longest time for an operating point to settle while it heats, in half-cycles of 50 Hz mains: the device's time, since a simulated hob
/// on a busy machine is slower than the host's clock.
pub const SETTLE_WITHIN: Duration = Duration::from_secs(6);

/// Half-cycle of 50 Hz mains.
const HALF_CYCLE: Duration = Duration::from_millis(10);

/// Half-cycles between two windows: a window of 57 kB takes 140 ms on a link of 400 kB/s.
pub const WINDOWS_EVERY: u8 = 20;

/// Longest wait for an event between two checks for ^C.
const STOP_CHECK_PERIOD: Duration = Duration::from_millis(100);

/// Longest wait for an event or a window, in device time.
pub(super) const TIMEOUT: Duration = Duration::from_secs(10);

/// Times that an idempotent command is sent.
const MAX_SENDS: usize = 3;

/// Truth by half-cycle number of the device, from a simulated hob; `None` on a real one.
pub type TruthSource = Option<Box<dyn Fn(u32) -> Option<Truth>>>;

/// Device in a training run. Dropping it, in a panic too, switches off a power that it has requested.
pub struct Device<'a> {
    /// `None` while the link is cut.
    client: Option<Client>,
    truth: TruthSource,
    progress: &'a mut dyn FnMut(RunProgress<'_>),
    stop: Option<&'a AtomicBool>,
    pub(super) last: Option<Telemetry>,
    /// Requested power in watt; 0 if none.
    asked_w: u16,
    /// Time of the last command to the device, on its clock.
    last_sent: Duration,
    /// Time of the last event from the device, on its clock.
    last_received: Duration,
    /// Set if telemetry shows the power that was requested last.
    is_confirmed: bool,
    /// Set if the device waits for a pot or pauses, and that was reported.
    is_waiting: bool,
    /// First failure of the recording.
    pub(super) not_recorded: Option<LinkError>,
}

/// Heating state of a half-cycle.
#[derive(Clone, Copy, PartialEq, Eq)]
enum HeatingState {
    /// It heats, or is about to.
    Heats,
    /// It waits for a pot or pauses, and heats again by itself.
    Waits,
}

impl<'a> Device<'a> {
    /// Takes over a connected device.
    pub fn start(
        client: Client,
        truth: TruthSource,
        stop: Option<&'a AtomicBool>,
        progress: &'a mut dyn FnMut(RunProgress<'_>),
    ) -> Self {
        let now = client.clock();
        Self {
            client: Some(client),
            truth,
            progress,
            stop,
            last: None,
            asked_w: 0,
            last_sent: now,
            last_received: now,
            is_confirmed: false,
            is_waiting: false,
            not_recorded: None,
        }
    }

    /// Drops the client, whose link is cut, and ends its recording.
    pub fn detach(&mut self) {
        if let Some(mut client) = self.client.take() {
            // The file is complete up to here.
            if let Err(why) = client.finish_recording() {
                self.note_recording(why);
            }
        }
    }

    /// Continues with the device over a new link.
    pub fn attach(&mut self, client: Client) {
        (self.last_sent, self.last_received) = (client.clock(), client.clock());
        self.client = Some(client);
        self.last = None;
    }

    /// Returns the client.
    ///
    /// # Errors
    /// [`LinkError::Closed`] while the link is cut.
    pub fn client(&mut self) -> Result<&mut Client, TrainerError> {
        let closed = || LinkError::Closed {
            device: "the device".into(),
        };
        Ok(self.client.as_mut().ok_or_else(closed)?)
    }

    /// Returns the link's counters since it was made; zeros while it is cut.
    pub fn counters(&self) -> ClientCounters {
        self.client
            .as_ref()
            .map(Client::counters)
            .unwrap_or_default()
    }

    /// Sends an idempotent command until it is answered, three times at most.
    pub fn command<T>(
        &mut self,
        mut command: impl FnMut(&mut Client) -> Result<T, LinkError>,
    ) -> Result<T, TrainerError> {
        let mut tries = 1;
        loop {
            let client = self.client()?;
            match command(client) {
                Err(LinkError::NoAnswer { .. }) if tries < MAX_SENDS => tries += 1,
                answer => {
                    self.last_sent = client.clock();
                    return Ok(answer?);
                }
            }
        }
    }

    /// Starts telemetry and windows.
    pub fn stream(&mut self) -> Result<(), TrainerError> {
        self.command(|client| client.stream(1, WINDOWS_EVERY))
    }

    /// Requests a power in watt; returns what the device took of it.
    pub fn request_power(&mut self, asked_w: u16) -> Result<u16, TrainerError> {
        // Set before the answer: the command may have arrived without one.
        self.asked_w = asked_w;
        self.is_confirmed = false;
        let granted = self.command(|client| client.set_power(asked_w))?;
        if granted.is_reduced() {
            self.report(RunProgress::Reduced(granted));
        }
        Ok(granted.granted_w)
    }

    /// Returns `true` if the run is to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// Checks the state in a half-cycle's telemetry: locked out, without pot and switched off are errors. A device that waits is reported
    /// once.
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
                if !self.is_waiting {
                    self.is_waiting = true;
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
                self.is_waiting = false;
                Ok(HeatingState::Heats)
            }
        }
    }

    /// Reports progress to the caller.
    pub fn report(&mut self, progress: RunProgress<'_>) {
        (self.progress)(progress);
    }

    /// Returns the truth of a window's half-cycle; `None` if it is not known.
    pub fn truth_of(&self, window: &Window) -> Option<Truth> {
        self.truth.as_ref()?(window.half_cycle)
    }

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
            let at_limit = f_sw_hz <= pwm::LOWEST_HZ || f_sw_hz >= pwm::HIGHEST_HZ;
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
    /// begins the second run ends the first.
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
        let window = window?;
        ended?;
        Ok(window)
    }

    /// Returns the next event, `None` if none has come yet. Sends a command from time to time, without which the device would switch off.
    ///
    /// # Errors
    /// [`TrainerError::Interrupted`] if the run is to end; [`TrainerError::Silent`] if nothing has come for 10 s.
    pub fn next_event(&mut self, what: &'static str) -> Result<Option<DeviceEvent>, TrainerError> {
        if self.is_stopped() {
            return Err(TrainerError::Interrupted);
        }
        let event = match self.client()?.next_event(STOP_CHECK_PERIOD) {
            Err(why @ LinkError::Recording(_)) => {
                self.note_recording(why);
                None
            }
            event => event?,
        };
        let now = self.client()?.clock();
        if now.saturating_sub(self.last_sent) >= KEEPALIVE_PERIOD {
            self.command(|client| client.status())?;
        }
        if event.is_some() {
            self.last_received = now;
        } else if now.saturating_sub(self.last_received) >= TIMEOUT {
            return Err(self.silent(what));
        }
        Ok(event)
    }

    /// Keeps the recording's first failure; the run goes on without a recording.
    fn note_recording(&mut self, why: LinkError) {
        self.report(RunProgress::Note {
            text: &why.to_string(),
        });
        self.not_recorded.get_or_insert(why);
    }

    fn silent(&self, what: &'static str) -> TrainerError {
        let c = self.counters();
        TrainerError::Silent {
            what,
            seconds: TIMEOUT.as_secs(),
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
                self.report(RunProgress::LookupActive {
                    version: lookup.version,
                    observed_cells: lookup.observed_cells(),
                });
                return Ok(());
            }
            // A lookup becomes active at a half-cycle boundary.
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

    /// Pushes a lookup. In a repetition after a lost answer, `LookupStale` means that the first one arrived.
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

    /// Switches the hob off and stops the streams.
    pub fn finish(&mut self) -> Result<(), TrainerError> {
        self.request_power(0)?;
        self.command(|client| client.stream(0, 0))
    }

    /// Ends the recording; returns its first failure.
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
            // No caller is left for an error; the device switches off by itself 10 s after the last command.
            let _ = self.finish();
        }
    }
}
