//! A daemon as an edge of the fleet: what is due goes there, what was found there comes back, and while the fleet is away the daemon goes
//! on by itself.
//!
//! ```text
//!  store (the outbox) ─► outbox.rs ─► IHD_WINDOWS ─► workers ─► IHD_RESULTS ─► inbox.rs ─► learner, store
//!                        events.rs ─► IHD_EVENTS          lookups.rs ◄─► ihd_lookups
//!                        pots.rs   ◄─► ihd_pots
//!                        cards.rs  ─► ihd_hobs, ihd_edges; states.rs ─► ihd.v1.<hob>.state
//!                        given_up.rs ◄─ IHD_DEAD
//! ```
//!
//! All of that only while the edge's name is this store's (name.rs). How long windows are left to the fleet: trust.rs.

mod acknowledged;
mod alarms;
mod cards;
mod events;
mod faults;
mod given_up;
mod inbox;
mod lookups;
mod name;
mod outbox;
mod pots;
mod states;
mod trust;

use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use async_nats::Event;
use ihd_daemon::Daemon;
use ihd_daemon::fleet::FleetConfig;
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use self::faults::Faults;
use self::trust::{Answers, Signs};
use crate::access::{Access, AccessError};
use crate::claims::Standing;
use crate::server::Server;

pub use self::events::EventMessage;
pub use self::states::StateMessage;

/// Between two tries after something failed.
const TRY_AGAIN: Duration = Duration::from_secs(2);

/// How long the tasks have to end.
const END_WITHIN: Duration = Duration::from_secs(5);

/// A daemon's part in the fleet. It goes on until [`Edge::stop`].
pub struct Edge {
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
}

/// What the tasks of an edge share.
pub(crate) struct Link {
    pub daemon: Daemon,
    pub server: Server,
    pub edge: String,
    /// Address of the server, without secrets.
    pub address: String,
    state: Arc<Mutex<State>>,
    /// Somebody who waits may find something to do.
    stirred: Notify,
    stop: watch::Receiver<bool>,
}

/// How the fleet does, as this edge sees it.
#[derive(Default)]
pub(crate) struct State {
    pub connected: bool,
    /// Reason for which the server does not answer; empty where it does.
    away: String,
    /// Right of this edge to its name.
    pub standing: Standing,
    pub faults: Faults,
    pub answers: Answers,
    pub signs: Signs,
}

impl Edge {
    /// Begins: the server is connected to as soon as it answers, and again whenever it is cut.
    ///
    /// # Errors
    /// [`AccessError`] where files or address cannot work.
    pub async fn start(daemon: Daemon, config: &FleetConfig) -> Result<Self, AccessError> {
        let access = Access::from(config);
        let edge = config.edge_name();
        let state = State::begin();
        let told = Arc::clone(&state);
        let on_event = move |event: Event| hear(&told, &event);
        let context = access.keep_connected(&edge, Box::new(on_event)).await?;
        let address = access.shown();
        tracing::info!(edge, server = address, "edge of a fleet");
        let server = Server::JetStream(Box::new(context.clone()), access);
        let (link, mut this) = Self::begin(daemon, edge, address, server, state);
        let tasks = &mut this.tasks;
        tasks.spawn(lookups::run(Arc::clone(&link), context.clone()));
        tasks.spawn(pots::run(Arc::clone(&link), context.clone()));
        tasks.spawn(cards::run(Arc::clone(&link), context.clone()));
        tasks.spawn(states::run(Arc::clone(&link), context.client()));
        if config.captures {
            tasks.spawn(crate::captures::follow(link, context));
        }
        Ok(this)
    }

    /// Begins the tasks that windows and results pass through.
    pub(crate) fn begin(
        daemon: Daemon,
        edge: String,
        address: String,
        server: Server,
        state: Arc<Mutex<State>>,
    ) -> (Arc<Link>, Self) {
        let (stop, stopped) = watch::channel(false);
        let link = Arc::new(Link {
            daemon,
            server,
            address,
            edge,
            state,
            stirred: Notify::new(),
            stop: stopped,
        });
        let mut tasks = JoinSet::new();
        tasks.spawn(name::run(Arc::clone(&link)));
        tasks.spawn(outbox::run(Arc::clone(&link)));
        tasks.spawn(events::run(Arc::clone(&link)));
        tasks.spawn(inbox::run(Arc::clone(&link)));
        tasks.spawn(given_up::run(Arc::clone(&link)));
        (link, Self { stop, tasks })
    }

    /// Ends it: before the daemon, whose store it uses.
    pub async fn stop(mut self) {
        self.stop.send_replace(true);
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        if tokio::time::timeout(END_WITHIN, ended).await.is_err() {
            tracing::warn!("what was on its way to the fleet is sent at the next start");
        }
    }
}

fn hear(state: &Mutex<State>, event: &Event) {
    let mut state = lock(state);
    match event {
        Event::Connected => state.connect(),
        Event::Disconnected | Event::LameDuckMode | Event::Draining | Event::Closed => {
            state.disconnect();
        }
        Event::ClientError(error) => state.away = error.to_string(),
        Event::ServerError(error) => state.away = error.to_string(),
        Event::SlowConsumer(_) => {}
    }
}

impl State {
    /// State of an edge that begins.
    pub fn begin() -> Arc<Mutex<Self>> {
        Arc::new(Mutex::new(Self {
            away: "the server has not answered yet".to_owned(),
            ..Self::default()
        }))
    }

    /// Notes that the server answers.
    pub fn connect(&mut self) {
        self.connected = true;
        self.away.clear();
        tracing::info!("the fleet's server answers");
    }

    /// Notes that the server does not answer any more.
    pub fn disconnect(&mut self) {
        if self.connected {
            tracing::warn!("the fleet's server is away: this daemon goes on by itself");
        }
        self.connected = false;
        self.away = "the server does not answer".to_owned();
    }
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every change is complete in itself.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Link {
    pub fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Returns `true` while this edge takes part in the fleet: the server answers, can do what is needed, and the edge's name is this store's.
    pub fn is_admitted(&self) -> bool {
        self.reaches() && self.state().standing == Standing::Held
    }

    /// Notes what failed; it is told once.
    pub fn failed(&self, part: &'static str, why: &dyn std::fmt::Display) {
        let why = why.to_string();
        if self.state().faults.failed(part, &why) {
            tracing::warn!("fleet: {part}: {why}");
        }
    }

    /// What failed works again.
    pub fn works(&self, part: &str) {
        let failures = self.state().faults.works(part);
        if failures > 0 {
            tracing::info!(failures, "fleet: {part}: it works again");
        }
    }

    /// Present failures in words; empty where there is none.
    pub fn why(&self) -> String {
        let state = self.state();
        let refused = match &state.standing {
            Standing::Refused(why) => why.as_str(),
            Standing::Unknown | Standing::Held => "",
        };
        let texts = [&*state.away, refused, &state.faults.text()];
        let texts = texts.into_iter().filter(|text| !text.is_empty());
        texts.collect::<Vec<_>>().join("; ")
    }

    /// Trusts the fleet for as long as the signs allow.
    pub fn renew(&self) {
        let mut state = self.state();
        let State { signs, answers, .. } = &mut *state;
        let until = signs.trusted_until(answers, Instant::now());
        let until = until.filter(|_| state.connected && state.standing == Standing::Held);
        if until.is_some() {
            state.away.clear();
        }
        drop(state);
        self.daemon.trust_fleet(until);
    }

    /// Returns `true` where the server answers and is new enough; logs where it is not.
    pub fn reaches(&self) -> bool {
        if !self.state().connected {
            return false;
        }
        match self.server.check() {
            Ok(()) => {
                self.works("server");
                true
            }
            Err(why) => {
                self.failed("server", &why);
                false
            }
        }
    }

    /// Names of this daemon's devices.
    pub fn hobs(&self) -> Vec<String> {
        let devices = self.daemon.devices().into_iter().map(|d| d.name);
        devices
            .filter(|name| ihd_daemon::config::is_name(name))
            .collect()
    }

    /// Ready once the edge ends.
    pub async fn stopping(&self) {
        let _ = self.stop.clone().wait_for(|&stopping| stopping).await;
    }

    /// Waits, no longer than until [`Link::stir`]; false where the edge ends.
    pub async fn wait(&self, time: Duration) -> bool {
        let stirred = tokio::time::timeout(time, self.stirred.notified());
        self.unless_stopping(stirred).await.is_some()
    }

    /// Ends all waiting: the edge has a part in the fleet now, or no more.
    pub fn stir(&self) {
        self.stirred.notify_waiters();
    }

    /// Waits for something; none where the edge ends before.
    pub async fn unless_stopping<T>(&self, what: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            () = self.stopping() => None,
            done = what => Some(done),
        }
    }
}

/// Milliseconds since 1970, UTC.
pub(crate) fn now_ms() -> i64 {
    jiff::Timestamp::now().as_millisecond()
}
