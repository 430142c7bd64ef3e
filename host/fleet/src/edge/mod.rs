//! A daemon as an edge of the fleet: what is due goes there, what was found there comes back, and while the fleet is away the daemon goes
//! on by itself.
//!
//! ```text
//!  store (the outbox) ─► outbox.rs ─► IHD_WINDOWS ─► workers ─► IHD_RESULTS ─► inbox.rs ─► learner, store
//!                        events.rs ─► IHD_EVENTS          lookups.rs ◄─► ihd_lookups
//!                        pots.rs   ◄─► ihd_pots
//!                        cards.rs  ─► ihd_hobs, ihd_edges; states.rs ─► ihd.v1.<hob>.state
//! ```

mod cards;
mod events;
mod inbox;
mod lookups;
mod outbox;
mod pots;
mod states;
mod trust;

use std::future::Future;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use async_nats::Event;
use async_nats::jetstream::Context;
use ihd_daemon::Daemon;
use ihd_daemon::fleet::FleetConfig;
use tokio::sync::watch;
use tokio::task::JoinSet;

use self::trust::Answers;
use crate::access::{Access, AccessError};

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
    pub context: Context,
    pub edge: String,
    pub server: String,
    access: Access,
    state: Arc<Mutex<State>>,
    stop: watch::Receiver<bool>,
}

/// How the fleet does, as this edge sees it.
#[derive(Default)]
pub(crate) struct State {
    pub connected: bool,
    /// Why what failed last did; empty where nothing does.
    pub why: String,
    pub answers: Answers,
}

impl Edge {
    /// Begins: the server is connected to as soon as it answers, and again whenever it is cut.
    ///
    /// # Errors
    /// [`AccessError`] where files or address cannot work.
    pub async fn start(daemon: Daemon, config: &FleetConfig) -> Result<Self, AccessError> {
        let access = Access::from(config);
        let edge = config.edge_name();
        let state = Arc::new(Mutex::new(State {
            why: "the server has not answered yet".to_owned(),
            ..State::default()
        }));
        let told = Arc::clone(&state);
        let on_event = move |event: Event| hear(&told, &event);
        let context = access.keep_connected(&edge, Box::new(on_event)).await?;
        let (stop, stopped) = watch::channel(false);
        let link = Arc::new(Link {
            daemon,
            context,
            server: access.shown(),
            access,
            edge,
            state,
            stop: stopped,
        });
        tracing::info!(edge = link.edge, server = link.server, "edge of a fleet");
        let mut tasks = JoinSet::new();
        tasks.spawn(outbox::run(Arc::clone(&link)));
        tasks.spawn(events::run(Arc::clone(&link)));
        tasks.spawn(inbox::run(Arc::clone(&link)));
        tasks.spawn(lookups::run(Arc::clone(&link)));
        tasks.spawn(pots::run(Arc::clone(&link)));
        tasks.spawn(cards::run(Arc::clone(&link)));
        tasks.spawn(states::run(Arc::clone(&link)));
        if config.captures {
            tasks.spawn(crate::captures::follow(Arc::clone(&link)));
        }
        Ok(Self { stop, tasks })
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
        Event::Connected => {
            state.connected = true;
            state.why.clear();
            tracing::info!("the fleet's server answers");
        }
        Event::Disconnected | Event::LameDuckMode | Event::Draining | Event::Closed => {
            if state.connected {
                tracing::warn!("the fleet's server is away: this daemon goes on by itself");
            }
            state.connected = false;
            state.why = "the server does not answer".to_owned();
        }
        Event::ClientError(error) => state.why = error.to_string(),
        Event::ServerError(error) => state.why = error.to_string(),
        Event::SlowConsumer(_) => {}
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

    pub fn is_connected(&self) -> bool {
        self.state().connected
    }

    /// Notes what failed; it is told once.
    pub fn failed(&self, what: &str, why: &dyn std::fmt::Display) {
        let text = format!("{what}: {why}");
        let mut state = self.state();
        if state.why != text {
            tracing::warn!("fleet: {text}");
            state.why = text;
        }
    }

    /// What failed works again.
    pub fn works(&self) {
        let mut state = self.state();
        if state.connected && !state.why.is_empty() {
            state.why.clear();
        }
    }

    /// Whether the server is new enough; told where it is not.
    pub fn serves(&self) -> bool {
        match self.access.check(&self.context.client()) {
            Ok(()) => true,
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

    /// Waits; false where the edge ends.
    pub async fn wait(&self, time: Duration) -> bool {
        self.unless_stopping(tokio::time::sleep(time))
            .await
            .is_some()
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
