//! Link of an edge's tasks: their shared data, and the turns that each takes.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::future::Future;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use futures_util::FutureExt;
use ihd_daemon::Daemon;
use ihd_daemon::locking::lock;
use tokio::sync::{Notify, watch};
use tokio::time::Instant;

use super::refusals::RETRY_PAUSE;
use super::state::State;
use crate::server::FleetServer;
use crate::standing::Standing;

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
    /// Random id of this run of the daemon.
    pub run: String,
}

/// Parts without which a hob's windows are not left to the fleet.
pub const SENDING: &str = "sending";
pub const RESULTS: &str = "results";
/// Part that stands for the store of this daemon.
pub const STORE: &str = "store";

impl Link {
    pub fn new(
        daemon: Daemon,
        edge: String,
        address: String,
        server: FleetServer,
        state: Arc<Mutex<State>>,
        stop: watch::Receiver<bool>,
    ) -> Self {
        Self {
            daemon,
            server,
            edge,
            address,
            state,
            wake: Notify::new(),
            stop,
            run: format!("{:016x}", RandomState::new().build_hasher().finish()),
        }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Returns `true` while this edge takes part in the fleet: the server answers, can do what is needed, and the edge's name is this store's.
    pub fn is_admitted(&self) -> bool {
        self.is_reachable() && self.state().standing == Standing::Held
    }

    /// Records a failure of a part; each text is logged once.
    pub fn failed(&self, part: &'static str, why: &dyn Display) {
        let why = why.to_string();
        if self.state().faults.failed(part, &why, Instant::now()) {
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

    /// Records that the server refuses something of a hob, in a turn that began at `began`.
    pub fn refused(&self, part: &'static str, hob: &str, why: &dyn Display, began: Instant) {
        let why = why.to_string();
        if self.state().refusals.refused(part, hob, &why, began) {
            tracing::warn!(hob, "fleet: {part}: {why}");
        }
    }

    /// Records what is wrong of a hob alone for certain.
    pub fn lacks(&self, part: &'static str, hob: &str, why: &str) {
        if self.state().refusals.lacks(part, hob, why, Instant::now()) {
            tracing::warn!(hob, "fleet: {part}: {why}");
        }
    }

    /// Records that the server accepts something of a hob.
    pub fn accepted(&self, part: &'static str, hob: &str) {
        let times = self.state().refusals.accepted(part, hob, Instant::now());
        if times > 0 {
            tracing::info!(hob, times, "fleet: {part}: it works again");
        }
    }

    /// Returns `true` unless a hob that was refused waits for its next try.
    pub fn may_try(&self, part: &'static str, hob: &str) -> bool {
        self.state().refusals.may_try(part, hob, Instant::now())
    }

    /// Returns the names of this daemon's devices without those that wait for their next try.
    pub fn hobs_to_try(&self, part: &'static str) -> Vec<String> {
        let mut hobs = self.hobs();
        self.state().refusals.keep(&hobs);
        hobs.retain(|hob| self.may_try(part, hob));
        hobs
    }

    /// Returns the hobs whose windows the fleet does not take, or whose answers do not arrive.
    fn not_served(&self) -> BTreeSet<String> {
        let refusals = &self.state().refusals;
        &refusals.hobs(SENDING) | &refusals.hobs(RESULTS)
    }

    /// Returns the text of all present failures, empty without any.
    pub fn failure_text(&self) -> String {
        let state = self.state();
        let refused = match &state.standing {
            Standing::Refused(why) => why.as_str(),
            Standing::Unknown | Standing::Held => "",
        };
        let texts = [state.away.clone(), refused.to_owned(), state.faults.text()];
        let texts = texts.into_iter().chain(state.refusals.of_outages());
        let texts = texts.filter(|text| !text.is_empty());
        texts.collect::<Vec<_>>().join("; ")
    }

    /// Delegates windows to the fleet for as long as [`Signs`](super::trust::Signs) allow.
    pub fn renew_delegation(&self) {
        let mut state = self.state();
        let State { signs, answers, .. } = &mut *state;
        let until = signs.delegated_until(answers, Instant::now());
        let until = until.filter(|_| state.connected && state.standing == Standing::Held);
        if until.is_some() {
            state.away.clear();
        }
        drop(state);
        self.daemon.fleet().delegate_until(until, self.not_served());
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

    /// Runs a part until the edge stops. A part that ends before is an alarm, and begins anew.
    pub async fn keep<F: Future<Output = ()>>(
        self: Arc<Self>,
        part: &'static str,
        run: impl Fn(Arc<Self>) -> F,
    ) {
        loop {
            // What a panic leaves behind is dropped with the part; locks are never poisoned for good (state.rs).
            let ended = AssertUnwindSafe(run(Arc::clone(&self)))
                .catch_unwind()
                .await;
            if self.is_stopping() {
                return;
            }
            tracing::error!(
                part,
                panicked = ended.is_err(),
                "a part of the edge has ended; it begins anew"
            );
            *self.state().ended.entry(part).or_default() += 1;
            if !self.wait(RETRY_PAUSE).await {
                return;
            }
        }
    }

    /// Returns the alarms of parts that have ended or fail, refused hobs and answers that nobody asked for.
    pub fn alarms(&self) -> Vec<String> {
        let (state, now) = (self.state(), Instant::now());
        let text = |(part, times): (&&str, &u32)| {
            format!(
                "the edge's part {part:?} has ended by an error of ihd and begun anew, {times} times: please report the log"
            )
        };
        let ended = state.ended.iter().map(text);
        let refused = state.refusals.alarms(now);
        ended
            .chain(state.faults.alarms(now))
            .chain(refused)
            .chain(state.oddities.alarms(now))
            .collect()
    }

    /// Returns `true` once the edge is to stop.
    pub fn is_stopping(&self) -> bool {
        *self.stop.borrow()
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

    /// Takes a turn of a part, and the pause that it returns, `failure_pause` if it fails; returns `false` if the edge stops.
    pub async fn turn<E: Display>(
        &self,
        part: &'static str,
        failure_pause: Duration,
        turn: impl Future<Output = Result<Duration, E>>,
    ) -> bool {
        let pause = turn.await.unwrap_or_else(|why| {
            self.failed(part, &why);
            failure_pause
        });
        self.wait(pause).await
    }

    /// Takes a turn as [`Link::turn`] does; a stop of the edge ends it at once.
    pub async fn turn_until_stop<E: Display>(
        &self,
        part: &'static str,
        failure_pause: Duration,
        turn: impl Future<Output = Result<Duration, E>>,
    ) -> bool {
        let turn = self.turn(part, failure_pause, turn);
        self.unless_stopping(turn).await.unwrap_or(false)
    }
}
