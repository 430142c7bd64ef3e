//! One connection to a device, from its hello to its end. It heats nothing by itself.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{AsyncClient, Client, Counters, Event, KEEPALIVE_PERIOD, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{NO_PANEL, Pot, State, Status, Telemetry};
use ihd_signal::truth::Truth;
use ihd_store::{CurveSource, DeviceId, SessionId};
use ihd_thermal::PotEvent;
use ihd_train::WINDOWS_EVERY;
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::pushing::Push;
use super::sweep::{Step, Sweep};
use super::{Context, Order, lease_ended};
use crate::TruthOf;
use crate::clocks::{Allowance, Clocks};
use crate::face::Face;
use crate::learning::{LearnInput, LearnJob, Lookup, truth_curve};
use crate::lease::{LeaseId, LeaseOver, Lost};
use crate::ledger::Arrival;
use crate::model::{DeviceState, Record, What};
use crate::pot_watch::words;
use crate::printable::printable;
use crate::states::{live, of_telemetry, pot_change};
use crate::store_thread::StoreAccess;
use crate::switching_off::switch_off;

/// How often the session looks at the clock, and shows what the device does.
const TICK: Duration = Duration::from_millis(100);

/// A device that says nothing for this long is asked whether it is there.
const SILENT: Duration = Duration::from_secs(2);

/// Answers that may stay away one after the other.
const UNANSWERED: u32 = 2;

/// How often what the link and the store say is looked at.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Half-cycles that a device's count may go back without it having begun anew: frames in another order.
const OUT_OF_ORDER: u32 = 1_000;

/// Half-cycles that are remembered until their window has come: two seconds.
const POWERS: usize = 256;

/// Between two tries of what the store could not do.
const TRY_AGAIN: Duration = Duration::from_secs(10);

/// Windows of a second that are taken: a device that keeps to what it was told sends six.
const WINDOWS_A_SECOND: u32 = 30;

/// Faults, and windows with a defect, of a second that are told.
const TOLD_A_SECOND: u32 = 10;

/// Half-cycles that wait for whoever follows the pot: what a fit takes, many times.
const POT_WAITING: usize = 1_000;

/// What is told of a pot at once, at most: a device that plays makes up more.
const POT_EVENTS: usize = 4;

/// How long a simulation may take to tell the truth.
const TRUTH_WITHIN: Duration = Duration::from_millis(200);

/// A state lasts this long before another one is told.
const STATE_LASTS: Duration = Duration::from_millis(400);

/// Why a session ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The daemon stops.
    Stopping,
    /// The link failed, or the device is not what it was; why.
    Link(String),
    /// This machine slept, or this process was stopped.
    Slept(String),
}

/// Why no power is asked for.
#[derive(Debug, thiserror::Error)]
pub(super) enum HeatError {
    /// Nobody answers for it.
    #[error(transparent)]
    Lease(#[from] LeaseOver),
    /// The device refused, or did not answer.
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// A session.
pub struct Session<'a> {
    pub(super) face: &'a Arc<Face>,
    pub(super) context: &'a Context,
    pub(super) client: Arc<AsyncClient>,
    pub(super) device: Option<DeviceId>,
    pub(super) session: Option<SessionId>,
    /// Under the lease that it was begun under.
    pub(super) sweep: Option<(LeaseId, Sweep)>,
    /// A lookup that the device took and does not use yet.
    pub(super) push: Option<Push>,
    /// A lookup that was learned, and waits for the one before it.
    pub(super) news: Option<Box<Lookup>>,
    clocks: Clocks,
    /// When the device was heard last, and heard from us.
    heard: Instant,
    told: Instant,
    /// When the lease's power was compared with the device's last.
    compared: Instant,
    looked: Instant,
    unanswered: u32,
    shown_half_cycle: Option<u32>,
    /// Jumps of the window numbers that were told.
    jumps: u32,
    /// Frames beyond what a hob sends that were counted.
    frames_beyond: u64,
    /// Store and device may hold different lookups: to be compared again.
    pub(super) owes_mending: bool,
    tried_again: Instant,
    windows_allowed: Allowance,
    told_allowed: Allowance,
    /// The last half-cycles, and in which it heated with which power in milliwatt.
    powers: VecDeque<(u32, bool, u32)>,
    /// What stood on the coil last, where it was looked at.
    pot: Option<Pot>,
    /// Half-cycles for whoever follows the pot, and that work under way.
    pot_waiting: Vec<(Telemetry, i64)>,
    pot_work: Option<JoinHandle<()>>,
    /// What R and L truly are, where the device is simulated here.
    truth: Option<Arc<TruthOf>>,
}

impl<'a> Session<'a> {
    /// With a device that has shaken hands.
    pub fn new(
        face: &'a Arc<Face>,
        context: &'a Context,
        client: Arc<AsyncClient>,
        truth: Option<Arc<TruthOf>>,
    ) -> Self {
        let now = Instant::now();
        Self {
            face,
            context,
            client,
            device: None,
            session: None,
            sweep: None,
            push: None,
            clocks: Clocks::new(&context.machine),
            heard: now,
            told: now,
            compared: now,
            looked: now,
            unanswered: 0,
            shown_half_cycle: None,
            jumps: 0,
            frames_beyond: 0,
            owes_mending: false,
            tried_again: now,
            windows_allowed: Allowance::new(WINDOWS_A_SECOND),
            told_allowed: Allowance::new(TOLD_A_SECOND),
            powers: VecDeque::new(),
            pot: None,
            pot_waiting: Vec::new(),
            pot_work: None,
            truth,
            news: None,
        }
    }

    /// Asks the device something.
    pub(super) async fn ask<T: Send + 'static>(
        &mut self,
        f: impl FnOnce(&mut Client) -> Result<T, LinkError> + Send + 'static,
    ) -> Result<T, LinkError> {
        self.told = Instant::now();
        self.client.with(f).await?
    }

    /// Runs until it ends.
    pub async fn run(
        &mut self,
        mut events: mpsc::Receiver<Event>,
        orders: &mut mpsc::Receiver<Order>,
    ) -> Ended {
        if let Err(error) = self.begin().await {
            return Ended::Link(error.to_string());
        }
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let on = tokio::select! {
                biased;
                () = self.context.stopping() => return Ended::Stopping,
                // Neither a flood of events nor one of orders keeps a lease from running out.
                _ = tick.tick() => {
                    if !events.is_empty() {
                        // It is not silent: its events wait here.
                        self.heard = Instant::now();
                    }
                    self.on_tick().await
                }
                order = orders.recv() => match order {
                    Some(order) => self.on_order(order).await,
                    None => return Ended::Stopping,
                },
                event = events.recv() => match event {
                    Some(event) => self.on_event(event).await,
                    None => Err(self.why_ended()),
                },
            };
            if let Err(ended) = on {
                return ended;
            }
        }
    }

    fn why_ended(&self) -> Ended {
        let why = self.client.ended().map(|error| error.to_string());
        Ended::Link(why.unwrap_or_else(|| "the link has ended".to_owned()))
    }

    /// What comes before the first event: who it is, what it does, what it uses.
    async fn begin(&mut self) -> Result<(), LinkError> {
        self.listen().await?;
        let status = self.ask(Client::status).await?;
        let boot = self.client.hello().boot_id;
        {
            let mut inner = self.face.lock();
            let due = status.windows_recorded.wrapping_add(status.windows_dropped);
            inner.ledger.connect(boot, due, status.windows_dropped);
        }
        self.face.pot_watch().of_boot(boot);
        self.end_former_power(&status).await?;
        self.begin_in_store().await;
        self.face.enter(DeviceState::Connected, "");
        self.reconcile(status.lookup_version).await?;
        self.ask(|client| client.stream(1, WINDOWS_EVERY)).await?;
        self.heard = Instant::now();
        Ok(())
    }

    /// Power of before this connection, which the device ended at our hello. One that heats on, and not for its panel, is switched off.
    async fn end_former_power(&mut self, status: &Status) -> Result<(), LinkError> {
        if status.asked_w == 0 || status.panel_level != NO_PANEL {
            self.face.lock().lease.switched_off();
            return Ok(());
        }
        let asked_w = status.asked_w;
        tracing::warn!(
            device = self.face.name,
            asked_w,
            "its hello did not end its heating: switched off"
        );
        self.off().await
    }

    /// The session in the store; without one, nothing is stored until there is.
    async fn begin_in_store(&mut self) {
        let (name, address) = (self.face.name.clone(), self.face.address.clone());
        let hello = self.client.hello().clone();
        let front_end = self.client.front_end().clone();
        let is_resumed = self.face.lock().is_resumed;
        let began = self.context.in_store(move |store| {
            let device = store.device(&name, &address)?;
            let session = store.begin_session(device, &hello, &front_end)?;
            let learned = match is_resumed {
                true => None,
                false => store.learner_state(device)?,
            };
            Ok((device, session, learned))
        });
        // The store's trouble is told by its thread.
        if let Some((device, session, learned)) = began.await {
            self.device = Some(device);
            self.session = Some(session);
            self.face.lock().is_resumed = true;
            let added = self
                .context
                .learner
                .add(&self.face.name, learned.as_deref());
            if let Err(error) = added {
                tracing::warn!(device = self.face.name, %error, "what was learned is lost");
                self.note("learned", &error.to_string());
            }
        }
    }

    async fn on_event(&mut self, event: Event) -> Result<(), Ended> {
        self.heard = Instant::now();
        self.unanswered = 0;
        match event {
            Event::Telemetry(t) => self.on_telemetry(t).await,
            Event::Window(window) => {
                self.on_window(window).await;
                Ok(())
            }
            Event::WindowRejected { seq, reason } => {
                let why = reason.to_string();
                {
                    let mut inner = self.face.lock();
                    if inner.ledger.arrived(seq) == Arrival::New {
                        inner.ledger.fates.refused += 1;
                    }
                }
                if self.told_allowed.take() {
                    tracing::debug!(device = self.face.name, seq, why, "window refused");
                    self.face.tell(What::WindowRefused { seq, why });
                }
                Ok(())
            }
            Event::Fault(_) if !self.told_allowed.take() => Ok(()),
            // The daemon asks for none.
            Event::Log { .. } => Ok(()),
            Event::Fault(event) => {
                let (fault, text) = (event.fault.number(), event.fault.text().to_owned());
                if event.fault == Fault::NONE {
                    tracing::info!(device = self.face.name, "fault cleared");
                } else {
                    tracing::warn!(device = self.face.name, fault, text, "fault");
                }
                let said = match fault {
                    0 => "cleared".to_owned(),
                    _ => format!("{fault}: {text}"),
                };
                self.note("fault", &said);
                self.face.tell(What::Fault { fault, text });
                Ok(())
            }
        }
    }

    /// An event for the store; if it has no room, for the log alone, and counted.
    pub(super) fn note(&self, kind: &'static str, text: &str) {
        let (device, text) = (self.device, printable(text));
        let store = self.store().writing_once(Record::Events);
        store.offer(move |store| store.event(device, kind, &text));
    }

    /// The store, in this device's lane.
    fn store(&self) -> StoreAccess {
        self.context.store.of_device(&self.face.name)
    }

    async fn on_telemetry(&mut self, t: Telemetry) -> Result<(), Ended> {
        self.face.ring().push(&t, Instant::now());
        let seconds = &self.context.seconds;
        seconds.push(&self.face.name, &t, self.context.machine.now_ms());
        self.look_at_pot(t.pot);
        if self.pot_waiting.len() < POT_WAITING {
            let now_ms = self.context.machine.now_ms();
            self.pot_waiting.push((t.clone(), now_ms));
        }
        let before = {
            let mut inner = self.face.lock();
            inner.lookup.on_device = Some(t.lookup_version);
            inner.last.replace(t.clone())
        };
        if self.powers.len() == POWERS {
            self.powers.pop_front();
        }
        let heats = t.state == State::Heating;
        self.powers.push_back((t.half_cycle, heats, t.power_mw));
        if before.is_some_and(|b| {
            b.half_cycle
                .wrapping_sub(t.half_cycle)
                .wrapping_sub(OUT_OF_ORDER)
                < 1 << 30
        }) {
            return Err(Ended::Link(
                "its half-cycles began anew: it was reset".to_owned(),
            ));
        }
        self.is_pushed(t.lookup_version).await;
        if let Some(sweep) = self.living_sweep() {
            let step = sweep.telemetry(&t, Instant::now());
            self.sweep_step(step).await?;
        }
        Ok(())
    }

    /// Tells what stands on the coil where it is another thing than before.
    fn look_at_pot(&mut self, pot: Pot) {
        if pot == Pot::Unknown || self.pot == Some(pot) {
            return;
        }
        let before = self.pot.replace(pot);
        if before.is_some() && self.told_allowed.take() {
            let text = pot_change(pot).to_owned();
            tracing::info!(device = self.face.name, text, "pot");
            self.face.tell(What::Pot {
                pot: format!("{pot:?}"),
                text,
            });
        }
    }

    /// Hands the last half-cycles to whoever follows the pot, on a thread that may take its time.
    fn follow_pot(&mut self) {
        let busy = self
            .pot_work
            .as_ref()
            .is_some_and(|work| !work.is_finished());
        if busy || self.pot_waiting.is_empty() {
            return;
        }
        let (face, waiting) = (Arc::clone(self.face), std::mem::take(&mut self.pot_waiting));
        self.pot_work = Some(self.context.machine.spawn_blocking(move || {
            let (mut events, curve) = {
                let mut watch = face.pot_watch();
                let events: Vec<_> = waiting
                    .iter()
                    .flat_map(|(t, at_ms)| watch.push(t, *at_ms))
                    .collect();
                (events, watch.curve())
            };
            *face.pot_curve() = curve;
            events.truncate(POT_EVENTS);
            for event in &events {
                let text = words(event);
                tracing::info!(device = face.name, text, "pot");
                let overheats = matches!(event, PotEvent::Overheats { .. });
                face.tell(What::PotTemperature { text, overheats });
            }
        }));
    }

    /// The truth of a half-cycle, where there is one to ask.
    async fn truth_of(&self, half_cycle: u32) -> Option<Arc<Truth>> {
        let truth = Arc::clone(self.truth.as_ref()?);
        // It may wait for the simulation.
        let asked = self
            .context
            .machine
            .spawn_blocking(move || truth(half_cycle));
        let told = tokio::time::timeout(TRUTH_WITHIN, asked).await;
        told.ok()?.ok()?.map(Arc::new)
    }

    /// A window goes to the store, and from there to whoever learns.
    async fn on_window(&mut self, window: Box<Window>) {
        // A fit may hold it; the next window tells the same.
        if let Some(mut watch) = self.face.try_pot_watch() {
            watch.half_cycle_lasts(1e-9 * f64::from(window.half_cycle_ns));
        }
        if let Some(sweep) = self.living_sweep() {
            sweep.window(window.half_cycle);
        }
        let seq = window.seq;
        if self.face.lock().ledger.arrived(seq) == Arrival::Again {
            return;
        }
        let boot = self.client.hello().boot_id;
        let half_cycle = window.half_cycle;
        let told = self.powers.iter().find(|(at, ..)| *at == half_cycle);
        let teaches = told.is_none_or(|(_, heats, _)| *heats);
        let power_w = told.map(|(_, _, power_mw)| f64::from(*power_mw) * 1e-3);
        let ids = self.device.zip(self.session);
        if ids.is_none() {
            // The store did not take the connection, which a window's row refers to.
            self.context.store.dropped(Record::Windows, 1);
        }
        let ids = ids.filter(|_| self.windows_allowed.take());
        let truth = match ids {
            Some(_) => self.truth_of(half_cycle).await,
            None => None,
        };
        let stored = ids.is_some_and(|(device_id, session)| {
            let face = Arc::clone(self.face);
            let learner = Arc::clone(&self.context.learner);
            let trust = Arc::clone(&self.context.trust);
            let store = self.store().writing_once(Record::Windows);
            store.offer(move |store| {
                let for_fleet = teaches && trust.is_edge;
                let kept = store.keep_window_for(session, &window, for_fleet);
                let mut inner = face.lock();
                match &kept {
                    Ok(_) => inner.ledger.fates.stored += 1,
                    Err(_) => inner.ledger.fates.not_stored += 1,
                }
                drop(inner);
                let (_, due) = kept?;
                face.tell(What::WindowStored { boot, seq });
                if let Some(truth) = &truth {
                    store.keep_curve(
                        session,
                        seq,
                        CurveSource::Truth,
                        &truth_curve(truth, &window),
                    )?;
                }
                if !teaches {
                    face.lock().ledger.fates.unfit += 1;
                } else if !(due && trust.holds()) {
                    // Else the fleet learns from it. What it makes room for, the learner counts.
                    learner.offer(LearnJob {
                        device: face.name.clone(),
                        device_id,
                        session,
                        boot,
                        input: LearnInput::Window(window),
                        power_w,
                        truth,
                        stored: None,
                    });
                }
                Ok(())
            })
        });
        if !stored {
            self.face.lock().ledger.fates.not_stored += 1;
        }
    }

    async fn on_tick(&mut self) -> Result<(), Ended> {
        if let Some(slept) = self.clocks.turn(&self.context.machine) {
            self.face.lock().lease.void();
            return Err(Ended::Slept(format!(
                "nothing ran here for {:.0} s",
                slept.as_secs_f64()
            )));
        }
        let expired = self.face.lock().lease.expired(Instant::now());
        if let Some(holder) = expired {
            lease_ended(self.face, &holder);
            self.off_for("the lease has run out").await?;
        }
        if self.face.lock().lease.must_end(Instant::now()) {
            self.off_for("no lease answers for its power").await?;
        }
        self.stay_in_touch().await?;
        self.face.recorder.tick();
        self.show();
        self.follow_pot();
        self.is_overdue().await;
        self.push_news().await;
        if let Some(sweep) = self.living_sweep() {
            let step = sweep.tick(Instant::now());
            self.sweep_step(step).await?;
        }
        if self.looked.elapsed() >= LOOK_EVERY {
            self.looked = Instant::now();
            self.look().await?;
        }
        Ok(())
    }

    /// Is heard where it must be, and asks whether a silent device is there.
    async fn stay_in_touch(&mut self) -> Result<(), Ended> {
        let heats_for_us = self.face.lock().lease.heats(Instant::now());
        let silent = self.heard.elapsed();
        let is_due = heats_for_us && self.compared.elapsed() >= KEEPALIVE_PERIOD;
        let is_silent = silent >= SILENT && self.told.elapsed() >= SILENT;
        if !is_due && !is_silent {
            return Ok(());
        }
        if is_silent {
            self.face.enter(
                DeviceState::Suspended,
                &format!("nothing came for {:.0} s", silent.as_secs_f64()),
            );
        }
        match self.compare_power().await {
            Ok(()) if is_silent => {
                self.unanswered += 1;
                // It answers, and streams nothing: as after a hello that we do not know of.
                let again = self.ask(|client| client.stream(1, WINDOWS_EVERY)).await;
                again.map_err(|error| Ended::Link(error.to_string()))?;
            }
            // Whoever switched off has its answer.
            Ok(()) | Err(LinkError::Preempted { .. }) => self.unanswered = 0,
            Err(error @ LinkError::NoAnswer { .. }) if self.unanswered < UNANSWERED => {
                self.unanswered += 1;
                tracing::debug!(device = self.face.name, %error, "no answer");
            }
            Err(error) => return Err(Ended::Link(error.to_string())),
        }
        if self.unanswered > UNANSWERED {
            return Err(Ended::Link(
                "it answers and sends no half-cycles".to_owned(),
            ));
        }
        Ok(())
    }

    /// Asks the device what it is asked for: another host's hello, or a hand at the panel, ends power that a lease still answers for.
    async fn compare_power(&mut self) -> Result<(), LinkError> {
        self.compared = Instant::now();
        let (face, runtime) = (Arc::clone(self.face), Handle::current());
        let compare = move |client: &mut Client| -> Result<_, LinkError> {
            let status = client.status()?;
            // On the link's thread, where power is asked for: what both know is of one moment.
            let _in_runtime = runtime.enter();
            let has_panel = status.panel_level != NO_PANEL;
            let lost = face.lock().lease.device_has(status.asked_w, has_panel);
            Ok(lost.map(|lost| (lost, status.asked_w)))
        };
        if let Some((lost, asked_w)) = self.ask(compare).await? {
            self.tell_lost(&lost, asked_w);
        }
        Ok(())
    }

    /// Tells that a lease ended because the device has `asked_w` in place of its power.
    fn tell_lost(&self, lost: &Lost, asked_w: u16) {
        let Lost { holder, power_w } = lost;
        let has = match asked_w {
            0 => "is asked for no power any more".to_owned(),
            asked_w => format!("is asked for {asked_w} W"),
        };
        let why = format!(
            "the hob {has}, and not for the {power_w} W of {holder}: another host spoke to it, or it was switched off there"
        );
        tracing::warn!(device = self.face.name, holder, why, "the lease has ended");
        self.note("lease", &why);
        self.face.tell(What::Lease {
            holder: String::new(),
            taken_from: String::new(),
            why,
        });
    }

    /// Publishes the last half-cycle, and the state that it shows.
    fn show(&mut self) {
        if self.heard.elapsed() >= SILENT {
            return;
        }
        let Some(t) = self.face.lock().last.clone() else {
            return;
        };
        self.show_state(&t);
        if self.shown_half_cycle != Some(t.half_cycle) {
            self.shown_half_cycle = Some(t.half_cycle);
            self.face.tell(What::Telemetry { live: live(&t) });
        }
    }

    /// The state that a half-cycle shows; not more often than a person can follow.
    fn show_state(&self, t: &Telemetry) {
        let (before, age) = self.face.state_and_age();
        let (state, detail) = of_telemetry(t, before);
        let passing = matches!(before, DeviceState::Connected | DeviceState::Suspended);
        if state == before || passing || age >= STATE_LASTS {
            self.face.enter(state, &detail);
        }
    }

    /// What the link counts, what failed beside it.
    async fn look(&mut self) -> Result<(), Ended> {
        let counted = self.client.with(|client| client.counters()).await;
        let Ok(Counters {
            windows,
            frames_beyond,
            ..
        }) = counted
        else {
            return Err(self.why_ended());
        };
        if windows.received > 0 || windows.missing > 0 {
            let mut inner = self.face.lock();
            inner.ledger.dropped_by_device(windows.dropped_by_device);
        }
        self.tell_flood(frames_beyond);
        let unlearned = self.context.learner.dropped_count(&self.face.name);
        let jumps = {
            let mut inner = self.face.lock();
            inner.ledger.fates.unlearned = unlearned;
            inner.ledger.jumps()
        };
        if jumps > std::mem::replace(&mut self.jumps, jumps) {
            tracing::warn!(
                device = self.face.name,
                jumps,
                "its windows are numbered in jumps"
            );
        }
        let beyond = self.told_allowed.take_beyond() + self.windows_allowed.take_beyond();
        if beyond > 0 {
            tracing::warn!(
                device = self.face.name,
                beyond,
                "more windows and faults than a device sends: not told"
            );
        }
        if self.tried_again.elapsed() >= TRY_AGAIN {
            self.tried_again = Instant::now();
            self.try_store_again().await?;
        }
        Ok(())
    }

    /// Counts what the device sent beyond what a hob sends, of this link `frames_beyond` so far; tells of it once a connection.
    fn tell_flood(&mut self, frames_beyond: u64) {
        let more = frames_beyond - std::mem::replace(&mut self.frames_beyond, frames_beyond);
        if more == 0 {
            return;
        }
        self.face.lock().frames_beyond += more;
        if more == frames_beyond {
            let text = "it sends more than a hob does: what is beyond that is dropped and counted";
            tracing::warn!(device = self.face.name, frames = more, "{text}");
            self.note("flood", text);
        }
    }

    /// What the store could not do when it was asked.
    async fn try_store_again(&mut self) -> Result<(), Ended> {
        if self.session.is_none() {
            self.begin_in_store().await;
            self.owes_mending |= self.session.is_some();
        }
        if self.session.is_some() && self.push.is_none() && std::mem::take(&mut self.owes_mending) {
            let on_device = self.face.lock().lookup.on_device.unwrap_or(0);
            let mended = self.reconcile(on_device).await;
            mended.map_err(|error| Ended::Link(error.to_string()))?;
        }
        Ok(())
    }

    /// The sweep, where its lease lives and no `off` came since.
    fn living_sweep(&mut self) -> Option<&mut Sweep> {
        let (lease, _) = self.sweep.as_ref()?;
        let mut inner = self.face.lock();
        if inner.lease.may_heat(*lease, Instant::now()).is_err() {
            inner.sweep_left_w.clear();
            self.sweep = None;
        }
        drop(inner);
        self.sweep.as_mut().map(|(_, sweep)| sweep)
    }

    /// Does what a sweep wants.
    pub(super) async fn sweep_step(&mut self, step: Step) -> Result<(), Ended> {
        match step {
            Step::Nothing => {}
            Step::Say(text) => {
                tracing::info!(device = self.face.name, "{text}");
                self.note("sweep", &text);
            }
            Step::Ask(power_w) => {
                tracing::info!(device = self.face.name, power_w, "sweep");
                let Some((lease, _)) = self.sweep else {
                    return Ok(());
                };
                if let Err(error) = self.heat(lease, power_w).await {
                    self.off_for(&format!("the sweep ended: {error}")).await?;
                }
            }
            Step::Over(why) => self.off_for(&format!("the sweep ended: {why}")).await?,
        }
        let sweep = self.sweep.as_ref();
        let left = sweep.map(|(_, sweep)| sweep.left_w()).unwrap_or_default();
        self.face.lock().sweep_left_w = left;
        Ok(())
    }

    /// Asks for power under a living lease.
    pub(super) async fn heat(&mut self, lease: LeaseId, power_w: u16) -> Result<(), HeatError> {
        if self.face.lock().lease.must_end(Instant::now()) {
            // What another lease left: this one begins with a hob that is off.
            self.off().await?;
        }
        self.told = Instant::now();
        let (face, runtime) = (Arc::clone(self.face), Handle::current());
        let asking = move |client: &mut Client| -> Result<(), HeatError> {
            // For the clock: this is the link's thread, where it is written down so that an `off` comes before it or after it.
            let _in_runtime = runtime.enter();
            let ask = |power_w| face.lock().lease.ask(lease, power_w, Instant::now());
            let before = ask(power_w)?;
            let asked = client.set_power(power_w);
            if let Err(LinkError::Refused { .. }) = &asked {
                // It goes on with what it had; a lease that ended meanwhile has left that to be switched off.
                let _ = ask(before);
            }
            Ok(asked?)
        };
        self.client.with(asking).await?
    }

    /// Switches off, and ends a sweep.
    pub(super) async fn off(&mut self) -> Result<(), LinkError> {
        self.sweep = None;
        self.face.lock().sweep_left_w.clear();
        self.told = Instant::now();
        switch_off(self.face, &self.client).await
    }

    /// Switches off what was asked for through the daemon, for a reason; nothing where nothing was.
    pub(super) async fn off_for(&mut self, why: &str) -> Result<(), Ended> {
        if self.face.lock().lease.asked_w() == 0 && self.sweep.is_none() {
            return Ok(());
        }
        tracing::info!(device = self.face.name, why, "off");
        self.note("off", why);
        self.off()
            .await
            .map_err(|error| Ended::Link(error.to_string()))
    }

    /// After the last event: off where we had asked for power, the recording finished, the session ended in
    /// the store.
    pub async fn close(&mut self, ended: &Ended) {
        if self.face.lock().lease.asked_w() > 0 {
            // Where the link is gone this fails at once, and the device ends it by itself.
            if let Err(error) = self.off().await {
                tracing::warn!(device = self.face.name, %error, "could not be switched off; it ends by itself within 10 s");
            }
        }
        self.leave_recording(ended).await;
        if *ended == Ended::Stopping {
            let _ = self.ask(|client| client.stream(0, 0)).await;
        }
        self.forget_push();
        let why = match ended {
            Ended::Stopping => "the daemon stopped".to_owned(),
            Ended::Link(why) | Ended::Slept(why) => printable(why),
        };
        if let Some(session) = self.session {
            let ending = self
                .context
                .in_store(move |store| store.end_session(session, &why));
            // The store's trouble is told by its thread.
            let _ = ending.await;
        }
    }
}
