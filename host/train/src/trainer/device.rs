//! Device of a training run: commands, events, lookups, the recording.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_link::{Client, ClientCounters, DeviceEvent, KEEPALIVE_PERIOD, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Outcome, Pot, State, Telemetry};
use ihd_signal::truth::Truth;

use super::{RunProgress, TrainerError};

mod operating_point;

/// Half-cycles between two windows: a window of 57 kB takes 140 ms on a link of 400 kB/s.
pub const WINDOWS_EVERY: u8 = 20;

/// Longest wait for an event between two checks for ^C.
const STOP_CHECK_PERIOD: Duration = Duration::from_millis(100);

/// Longest wait for an event or a window, in device time.
pub(super) const TIMEOUT: Duration = Duration::from_secs(10);

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
    /// `true` if the device was idle when it was last seen, which outlasts a cut link: a person or the device itself has ended the power.
    pub(super) is_switched_off: bool,
    /// Reason for which the device waits for a pot or pauses, as it was reported; `None` if it does not.
    waits_for: Option<(State, Pot, Fault)>,
    /// First failure of the recording.
    pub(super) not_recorded: Option<LinkError>,
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
            is_switched_off: false,
            waits_for: None,
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

    /// Sends a command; the client repeats it until it is answered ([`Client::request`]).
    pub fn command<T>(
        &mut self,
        command: impl FnOnce(&mut Client) -> Result<T, LinkError>,
    ) -> Result<T, TrainerError> {
        let client = self.client()?;
        let answer = command(client);
        self.last_sent = client.clock();
        Ok(answer?)
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

    /// Reports progress to the caller.
    pub fn report(&mut self, progress: RunProgress<'_>) {
        (self.progress)(progress);
    }

    /// Returns the truth of a window's half-cycle; `None` if it is not known.
    pub fn truth_of(&self, window: &Window) -> Option<Truth> {
        self.truth.as_ref()?(window.half_cycle)
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
