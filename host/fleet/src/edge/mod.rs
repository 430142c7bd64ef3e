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
mod link;
mod lookups;
mod name;
mod oddities;
mod outbox;
mod pots;
mod refusals;
pub(crate) mod state;
mod states;
#[cfg(test)]
mod tests;
pub(crate) mod trust;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use async_nats::Event;
use ihd_daemon::Daemon;
use ihd_daemon::fleet::FleetConfig;
use ihd_daemon::locking::lock;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::access::{Access, AccessError};
use crate::server::FleetServer;

use self::link::Link;

pub(crate) use self::state::State;

pub use self::events::EventMessage;
pub use self::states::StateMessage;

/// Longest time that the tasks have to stop.
const END_WITHIN: Duration = Duration::from_secs(5);

/// A daemon's tasks in the fleet, until [`Edge::stop`].
pub struct Edge {
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
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
        let with = || (Arc::clone(&link), context.clone());
        let (kept, context) = with();
        tasks.spawn(kept.keep("lookups", move |link| lookups::run(link, context.clone())));
        let (kept, context) = with();
        tasks.spawn(kept.keep("pots", move |link| pots::run(link, context.clone())));
        let (kept, context) = with();
        tasks.spawn(kept.keep("cards", move |link| cards::run(link, context.clone())));
        let (kept, context) = with();
        tasks.spawn(kept.keep("states", move |link| states::run(link, context.client())));
        if config.captures {
            let (kept, context) = with();
            tasks.spawn(kept.keep("captures", move |link| captures::run(link, context.clone())));
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
        let link = Arc::new(Link::new(daemon, edge, address, server, state, stopped));
        let mut tasks = JoinSet::new();
        tasks.spawn(Arc::clone(&link).keep("name", name::run));
        tasks.spawn(Arc::clone(&link).keep("outbox", outbox::run));
        tasks.spawn(Arc::clone(&link).keep("events", events::run));
        tasks.spawn(Arc::clone(&link).keep("inbox", inbox::run));
        tasks.spawn(Arc::clone(&link).keep("given up", given_up::run));
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
