//! Session: one connection to a device, from the handshake to its end. It heats nothing by itself.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{AsyncClient, Client, DeviceEvent, LinkError};
use ihd_model::{DeviceState, EventKind, RecordKind};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{State, Telemetry};
use ihd_store::{DeviceId, SessionId};
use ihd_train::WINDOWS_EVERY;
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::contact::Contact;
use super::device_link::DeviceLink;
use super::device_lookups::DeviceLookups;
use super::flood_limits::FloodLimits;
use super::pot_follower::{PotFollower, publish_change};
use super::report::publish_lease_expired;
use super::request::DeviceRequest;
use super::store_wait::StoreWait;
use super::sweep::SweepState;
use crate::TruthFn;
use crate::context::Context;
use crate::device_record::DeviceRecord;
use crate::lease::LeaseId;
use crate::printable::printable;
use crate::states::device_state;
use crate::window_accounting::{Arrival, WindowCounter};

/// Period of the session timer (lease, keep-alive, live view); 10 Hz is as fast as the page draws.
const TICK: Duration = Duration::from_millis(100);

/// Smallest step back of the half-cycle count that reordered frames do not explain: it means a restarted device.
const OUT_OF_ORDER: u32 = 1_000;

/// Time without telemetry after which no step back is one of reordered frames.
const REORDERING_TIME: Duration = Duration::from_secs(2);

/// Half-cycles whose power is held until their window arrives: two seconds.
const POWER_HISTORY: usize = 256;

/// Shortest time between two changes of state, so that a person can follow them.
const MIN_STATE_DURATION: Duration = Duration::from_millis(400);

/// Reason for the end of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SessionEnd {
    /// The daemon stops.
    Stopping,
    /// The link failed or the device restarted, with the reason.
    Link(String),
    /// This machine was suspended or this process was stopped, with the duration as text.
    Suspended(String),
}

/// Cause for which a session wakes.
enum Wake {
    Tick,
    /// A request; `None` once there are no more.
    Request(Option<DeviceRequest>),
    /// An event of the device; `None` once the link has ended.
    Event(Option<DeviceEvent>),
}

/// Rows of a session and its device in the store.
#[derive(Clone, Copy)]
pub(super) struct StoredIds {
    pub(super) device: DeviceId,
    pub(super) session: SessionId,
}

/// Returns `true` if a half-cycle count that came `pause` after the one `before` it is that of a restarted device. Over a serial port
/// nothing else shows a restart.
fn has_restarted(before: u32, count: u32, pause: Duration) -> bool {
    let smallest = if pause < REORDERING_TIME {
        OUT_OF_ORDER
    } else {
        1
    };
    before.wrapping_sub(count).wrapping_sub(smallest) < 1 << 30
}

/// State of a session.
pub struct DeviceSession<'a> {
    pub(super) record: &'a Arc<DeviceRecord>,
    pub(super) context: &'a Context,
    pub(super) link: DeviceLink,
    /// Waits for the store.
    pub(super) store_wait: Arc<StoreWait>,
    /// Rows of the session in the store; `None` until it is stored.
    pub(super) stored: Option<StoredIds>,
    /// Sweep with the lease under which it was started.
    pub(super) sweep: Option<(LeaseId, SweepState)>,
    pub(super) lookups: DeviceLookups<'a>,
    published_half_cycle: Option<u32>,
    last_telemetry: Instant,
    /// Logged jumps in the window numbering.
    pub(super) logged_jumps: u32,
    pub(super) last_store_retry: Instant,
    pub(super) flood: FloodLimits,
    /// Last half-cycles: count, `true` if heating, power in milliwatt.
    pub(super) recent_powers: VecDeque<(u32, bool, u32)>,
    pot: PotFollower,
    /// True R and L; `None` unless the device is simulated in this process.
    pub(super) truth: Option<Arc<TruthFn>>,
}

impl<'a> DeviceSession<'a> {
    /// Creates the session of a device after the handshake.
    pub fn new(
        record: &'a Arc<DeviceRecord>,
        context: &'a Context,
        client: Arc<AsyncClient>,
        truth: Option<Arc<TruthFn>>,
    ) -> Self {
        let store_wait = Arc::new(StoreWait::new(context.store.clone()));
        Self {
            record,
            context,
            lookups: DeviceLookups::new(record, context, Arc::clone(&store_wait)),
            store_wait,
            link: DeviceLink {
                client,
                contact: Contact::new(&context.machine),
            },
            stored: None,
            sweep: None,
            published_half_cycle: None,
            last_telemetry: Instant::now(),
            logged_jumps: 0,
            last_store_retry: Instant::now(),
            flood: FloodLimits::default(),
            recent_powers: VecDeque::new(),
            pot: PotFollower::default(),
            truth,
        }
    }

    /// Runs the session. Returns the reason for its end.
    pub async fn run(
        &mut self,
        mut events: mpsc::Receiver<DeviceEvent>,
        requests: &mut mpsc::Receiver<DeviceRequest>,
    ) -> SessionEnd {
        if let Err(error) = self.begin().await {
            return SessionEnd::Link(error.to_string());
        }
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            self.link.contact.begin_wait(&self.context.machine);
            let wake = tokio::select! {
                biased;
                () = self.context.stopping() => return SessionEnd::Stopping,
                // Ahead of requests and events, so that no flood of them delays the end of a lease.
                _ = tick.tick() => Wake::Tick,
                request = requests.recv() => Wake::Request(request),
                event = events.recv() => Wake::Event(event),
            };
            self.store_wait.begin_step();
            let outcome = match (self.check_suspend(), wake) {
                (Err(end), _) => return end,
                (Ok(()), Wake::Tick) => {
                    if !events.is_empty() {
                        self.link.contact.on_queued_event();
                    }
                    self.on_tick().await
                }
                (Ok(()), Wake::Request(Some(request))) => self.on_request(request).await,
                (Ok(()), Wake::Request(None)) => return SessionEnd::Stopping,
                (Ok(()), Wake::Event(Some(event))) => self.on_event(event).await,
                (Ok(()), Wake::Event(None)) => Err(self.link_end()),
            };
            if let Err(end) = outcome {
                return end;
            }
        }
    }

    /// Ends the lease and the session if this machine or process did not run during the last wait.
    fn check_suspend(&mut self) -> Result<(), SessionEnd> {
        let Some(suspended) = self.link.contact.end_wait(&self.context.machine) else {
            return Ok(());
        };
        let why = format!("nothing ran here for {:.0} s", suspended.as_secs_f64());
        if self.record.lock().lease.revoke().is_some() {
            self.record.publish_lease_end(why.clone());
        }
        Err(SessionEnd::Suspended(why))
    }

    pub(super) fn link_end(&self) -> SessionEnd {
        let why = self.link.client.ended().map(|error| error.to_string());
        SessionEnd::Link(why.unwrap_or_else(|| "the link has ended".to_owned()))
    }

    /// Sets the session up: recorder, accounting, power left from before, store, lookup, streams.
    async fn begin(&mut self) -> Result<(), LinkError> {
        self.attach_recorder().await?;
        let status = self.link.request(Client::status).await?;
        let boot = self.link.client.hello().boot_id;
        {
            let mut inner = self.record.lock();
            let due = status.windows_recorded.wrapping_add(status.windows_dropped);
            inner.windows.connect(boot, due, status.windows_dropped);
        }
        self.record.pot_tracker().begin_boot(boot);
        self.end_previous_power(&status).await?;
        self.begin_stored_session().await?;
        self.record.enter(DeviceState::Connected, "");
        self.lookups
            .reconcile(&mut self.link, status.lookup_version)
            .await?;
        self.link
            .request(|client| client.stream(1, WINDOWS_EVERY))
            .await?;
        self.link.contact.on_queued_event();
        Ok(())
    }

    async fn on_event(&mut self, event: DeviceEvent) -> Result<(), SessionEnd> {
        self.link.contact.on_event();
        match event {
            DeviceEvent::Telemetry(t) => self.on_telemetry(t).await,
            DeviceEvent::Window(window) => {
                self.on_window(window);
                Ok(())
            }
            DeviceEvent::WindowRejected { seq, reason } => {
                let why = reason.to_string();
                {
                    let mut inner = self.record.lock();
                    if inner.windows.arrived(seq) == Arrival::New {
                        inner.windows.count(WindowCounter::Refused);
                    }
                }
                if self.flood.events.allow() {
                    tracing::debug!(device = self.record.name, seq, why, "window refused");
                    self.record.publish(EventKind::WindowRefused { seq, why });
                }
                Ok(())
            }
            DeviceEvent::Fault(_) if !self.flood.events.allow() => Ok(()),
            // The daemon requests no log.
            DeviceEvent::Log { .. } => Ok(()),
            DeviceEvent::Fault(event) => {
                let (fault, text) = (event.fault.number(), event.fault.text().to_owned());
                if event.fault == Fault::NONE {
                    tracing::info!(device = self.record.name, "fault cleared");
                } else {
                    tracing::warn!(device = self.record.name, fault, text, "fault");
                }
                let description = match fault {
                    0 => "cleared".to_owned(),
                    _ => format!("{fault}: {text}"),
                };
                self.store_event("fault", &description);
                self.record.publish(EventKind::Fault { fault, text });
                Ok(())
            }
        }
    }

    async fn on_telemetry(&mut self, t: Telemetry) -> Result<(), SessionEnd> {
        let now = Instant::now();
        let pause = now.duration_since(std::mem::replace(&mut self.last_telemetry, now));
        self.record.ring().push(&t, now);
        let buffer = &self.context.telemetry;
        buffer.push(&self.record.name, &t, self.context.machine.now_ms());
        if self.pot.detect(t.pot) && self.flood.events.allow() {
            publish_change(self.record, t.pot);
        }
        self.pot.push(&t, self.context.machine.now_ms());
        let before = {
            let mut inner = self.record.lock();
            inner.lookup.on_device = Some(t.lookup_version);
            inner.power.push(&t, now);
            inner.last.replace(t.clone())
        };
        if self.recent_powers.len() == POWER_HISTORY {
            self.recent_powers.pop_front();
        }
        let is_heating = t.state == State::Heating;
        self.recent_powers
            .push_back((t.half_cycle, is_heating, t.power_mw));
        if before.is_some_and(|b| has_restarted(b.half_cycle, t.half_cycle, pause)) {
            return Err(SessionEnd::Link(
                "its half-cycles began anew: it was reset".to_owned(),
            ));
        }
        let version = t.lookup_version;
        self.lookups.reported(&mut self.link, version).await;
        if let Some(sweep) = self.active_sweep() {
            let step = sweep.telemetry(&t, Instant::now());
            self.apply_sweep_step(step).await?;
        }
        Ok(())
    }

    async fn on_tick(&mut self) -> Result<(), SessionEnd> {
        let expired = self.record.lock().lease.expired(Instant::now());
        if let Some(holder) = expired {
            publish_lease_expired(self.record, &holder);
            self.end_heating("the lease has run out").await?;
        }
        if self.record.lock().lease.must_switch_off(Instant::now()) {
            self.end_heating("no lease answers for its power").await?;
        }
        self.keep_alive().await?;
        self.record.recorder.tick();
        self.publish_live();
        let device = self.stored.map(|ids| ids.device);
        let store = self.store().writing(RecordKind::State);
        self.pot
            .track(self.record, &self.context.machine, device, store);
        self.lookups.tick(&mut self.link).await;
        if let Some(sweep) = self.active_sweep() {
            let step = sweep.tick(Instant::now());
            self.apply_sweep_step(step).await?;
        }
        if self.link.contact.is_poll_due() {
            self.poll_counters().await?;
        }
        Ok(())
    }

    /// Publishes the last half-cycle and updates the device state from it.
    fn publish_live(&mut self) {
        if self.link.contact.is_silent() {
            return;
        }
        let Some(t) = self.record.lock().last.clone() else {
            return;
        };
        self.update_state(&t);
        if self.published_half_cycle != Some(t.half_cycle) {
            self.published_half_cycle = Some(t.half_cycle);
            if let Some(live) = self.record.lock().live() {
                self.record.publish(EventKind::Telemetry { live });
            }
        }
    }

    /// Enters the state of a half-cycle, at most once per `MIN_STATE_DURATION`.
    fn update_state(&self, t: &Telemetry) {
        let (before, age) = self.record.state_and_age();
        let (state, detail) = device_state(t, before);
        let passing = matches!(before, DeviceState::Connected | DeviceState::Suspended);
        if state == before || passing || age >= MIN_STATE_DURATION {
            self.record.enter(state, &detail);
        }
    }

    /// Closes the session after its last event: switches off power requested through the daemon, detaches the recorder,
    /// ends the session in the store.
    pub async fn close(&mut self, end: &SessionEnd) {
        self.store_wait.begin_end();
        let why = match end {
            SessionEnd::Stopping => "the daemon stopped".to_owned(),
            SessionEnd::Link(why) | SessionEnd::Suspended(why) => printable(why),
        };
        // Without a link this fails at once, and the device ends its power itself.
        if self.end_heating(&why).await.is_err() {
            tracing::warn!(
                device = self.record.name,
                "could not be switched off; it ends by itself within 10 s"
            );
            if self.record.lock().lease.revoke().is_some() {
                let why = format!("{why}; the hob ends its power by itself within 10 s");
                self.record.publish_lease_end(why);
            }
        }
        // Without a link nobody knows what it does.
        self.record.lock().last = None;
        self.detach_recorder(end).await;
        if *end == SessionEnd::Stopping {
            let _ = self.link.request(|client| client.stream(0, 0)).await;
        }
        self.lookups.abandon_push();
        if let Some(StoredIds { session, .. }) = self.stored {
            let ending = self
                .store_wait
                .run(move |store| store.end_session(session, &why));
            // Errors of the store are reported by its thread.
            let _ = ending.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that restarts in its first ten seconds was taken for one whose frames are out of order.
    #[test]
    fn a_step_back_is_a_restart_if_it_is_large_or_comes_after_a_pause() {
        let [soon, late] = [10, 2_500].map(Duration::from_millis);
        for (before, count, pause, restarted) in [
            (5_000, 4_001, soon, false),
            (5_000, 4_000, soon, true),
            (900, 250, soon, false),
            (900, 250, late, true),
            (900, 900, late, false),
            (900, 1_150, late, false),
            (u32::MAX, 100, late, false),
            (100, u32::MAX, soon, false),
        ] {
            let found = has_restarted(before, count, pause);
            assert_eq!(found, restarted, "{before} {count} {pause:?}");
        }
    }
}
