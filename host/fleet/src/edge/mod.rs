//! A daemon as an edge of the fleet: sends windows, receives results, and identifies windows itself while the fleet is not available.
//!
//! ```text
//!  store (the outbox) ─► outbox.rs ─► IHD_WINDOWS ─► workers ─► IHD_RESULTS ─► inbox.rs ─► learner, store
//!                        events.rs ─► IHD_EVENTS          lookups.rs ◄─► ihd_lookups
//!                        pots.rs   ◄─► ihd_pots
//!                        cards.rs  ─► ihd_hobs, ihd_edges; states.rs ─► ihd.v1.<hob>.state
//!                        given_up.rs ◄─ IHD_DEAD; captures.rs ─► ihd_captures
//! ```
//!
//! All of that only while the edge's name is this store's (name.rs). trust.rs decides for how long windows are left to the fleet.

mod acknowledged;
mod alarms;
mod captures;
mod cards;
mod events;
mod faults;
mod given_up;
mod inbox;
mod lookups;
mod name;
mod outbox;
mod pots;
pub(crate) mod state;
mod states;
mod trust;

use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use async_nats::Event;
use ihd_daemon::Daemon;
use ihd_daemon::fleet::FleetConfig;
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::access::{Access, AccessError};
use crate::server::FleetServer;
use crate::standing::Standing;

pub(crate) use self::state::{State, lock};

pub use self::events::EventMessage;
pub use self::states::StateMessage;

/// Pause after a failure.
const TRY_AGAIN: Duration = Duration::from_secs(2);

/// Longest time that the tasks have to stop.
const END_WITHIN: Duration = Duration::from_secs(5);

/// A daemon's tasks in the fleet, until [`Edge::stop`].
pub struct Edge {
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
}

/// Data shared by the tasks of an edge.
pub(crate) struct Link {
    pub daemon: Daemon,
    pub server: FleetServer,
    pub edge: String,
    /// Address of the server, without secrets.
    pub address: String,
    state: Arc<Mutex<State>>,
    /// Ends all waiting in [`Link::wait`].
    wake: Notify,
    stop: watch::Receiver<bool>,
}

impl Edge {
    /// Starts the tasks: the server is connected as soon as it answers, and again whenever the connection ends.
    ///
    /// # Errors
    /// [`AccessError`] if a file or the address is unusable.
    pub async fn start(daemon: Daemon, config: &FleetConfig) -> Result<Self, AccessError> {
        let access = Access::from(config);
        let edge = config.edge_name();
        let state = State::begin();
        let connection = Arc::clone(&state);
        let on_event = move |event: Event| lock(&connection).apply(&event);
        let context = access.keep_connected(&edge, Box::new(on_event)).await?;
        let address = access.shown();
        tracing::info!(edge, server = address, "edge of a fleet");
        let server = FleetServer::JetStream(Box::new(context.clone()), access);
        let (link, mut this) = Self::begin(daemon, edge, address, server, state);
        let tasks = &mut this.tasks;
        tasks.spawn(lookups::run(Arc::clone(&link), context.clone()));
        tasks.spawn(pots::run(Arc::clone(&link), context.clone()));
        tasks.spawn(cards::run(Arc::clone(&link), context.clone()));
        tasks.spawn(states::run(Arc::clone(&link), context.client()));
        if config.captures {
            tasks.spawn(captures::run(link, context));
        }
        Ok(this)
    }

    /// Starts the tasks of windows and results.
    pub(crate) fn begin(
        daemon: Daemon,
        edge: String,
        address: String,
        server: FleetServer,
        state: Arc<Mutex<State>>,
    ) -> (Arc<Link>, Self) {
        let (stop, stopped) = watch::channel(false);
        let link = Arc::new(Link {
            daemon,
            server,
            address,
            edge,
            state,
            wake: Notify::new(),
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

    /// Stops the tasks; to be called before the daemon stops, whose store they use.
    pub async fn stop(mut self) {
        self.stop.send_replace(true);
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        if tokio::time::timeout(END_WITHIN, ended).await.is_err() {
            tracing::warn!("what was on its way to the fleet is sent at the next start");
        }
    }
}

impl Link {
    pub fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Returns `true` while this edge takes part in the fleet: the server answers, can do what is needed, and the edge's name is this store's.
    pub fn is_admitted(&self) -> bool {
        self.is_reachable() && self.state().standing == Standing::Held
    }

    /// Records a failure of a part; each text is logged once.
    pub fn failed(&self, part: &'static str, why: &dyn std::fmt::Display) {
        let why = why.to_string();
        if self.state().faults.failed(part, &why) {
            tracing::warn!("fleet: {part}: {why}");
        }
    }

    /// Records that a part works, which ends its failures.
    pub fn works(&self, part: &str) {
        let failures = self.state().faults.works(part);
        if failures > 0 {
            tracing::info!(failures, "fleet: {part}: it works again");
        }
    }

    /// Returns the text of all present failures, empty without any.
    pub fn failure_text(&self) -> String {
        let state = self.state();
        let refused = match &state.standing {
            Standing::Refused(why) => why.as_str(),
            Standing::Unknown | Standing::Held => "",
        };
        let texts = [&*state.away, refused, &state.faults.text()];
        let texts = texts.into_iter().filter(|text| !text.is_empty());
        texts.collect::<Vec<_>>().join("; ")
    }

    /// Delegates windows to the fleet for as long as [`Signs`](trust::Signs) allow.
    pub fn renew_delegation(&self) {
        let mut state = self.state();
        let State { signs, answers, .. } = &mut *state;
        let until = signs.delegated_until(answers, Instant::now());
        let until = until.filter(|_| state.connected && state.standing == Standing::Held);
        if until.is_some() {
            state.away.clear();
        }
        drop(state);
        self.daemon.fleet().delegate_until(until);
    }

    /// Returns `true` if the server answers and is new enough; records the failure if it is too old.
    pub fn is_reachable(&self) -> bool {
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

    /// Returns the names of this daemon's devices.
    pub fn hobs(&self) -> Vec<String> {
        let devices = self.daemon.view().devices().into_iter().map(|d| d.name);
        devices
            .filter(|name| ihd_daemon::config::is_name(name))
            .collect()
    }

    /// Waits until the edge stops.
    pub async fn stopping(&self) {
        let _ = self.stop.clone().wait_for(|&stopping| stopping).await;
    }

    /// Waits for a time or until [`Link::wake_waiting`]; returns `false` if the edge stops.
    pub async fn wait(&self, time: Duration) -> bool {
        let wake = tokio::time::timeout(time, self.wake.notified());
        self.unless_stopping(wake).await.is_some()
    }

    /// Ends all waiting, because the edge was admitted to the fleet or refused.
    pub fn wake_waiting(&self) {
        self.wake.notify_waiters();
    }

    /// Waits for a future; `None` if the edge stops before.
    pub async fn unless_stopping<T>(&self, what: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            () = self.stopping() => None,
            done = what => Some(done),
        }
    }
}
