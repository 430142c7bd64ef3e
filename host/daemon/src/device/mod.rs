//! The task of one device: finds it, keeps a session with it, finds it again.
//!
//! ```text
//!  searching ──► shakes hands ──► session (session.rs) ──► ended: why ──► searching …
//!      │              └ another protocol: incompatible, tried again every 30 s
//!      └ 0.2 s to 5 s between two tries; orders are answered meanwhile
//! ```

mod commands;
pub mod lookups;
mod pushing;
mod recording;
mod session;
pub mod sweep;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{AsyncClient, LinkError};
use ihd_store::{Store, StoreError};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

use crate::clocks::Backoff;
use crate::config::Address;
use crate::face::{Face, identity};
use crate::firmware::updates_needed;
use crate::fleet::Trust;
use crate::history::Seconds;
use crate::learning::{Learner, Lookup};
use crate::lease::LeaseId;
use crate::machine::Machine;
use crate::model::{Command, CommandError, DeviceState, Done, Record, What};
use crate::printable::printable;
use crate::store_thread::StoreThread;
use crate::{OpenDevice, TruthOf};

pub use session::Ended;
use session::Session;

/// Between two looks at a device that speaks another protocol.
const INCOMPATIBLE_EVERY: Duration = Duration::from_secs(30);

/// Events of a device that may wait for its task.
const EVENTS: usize = 256;

/// A session that lasted this long was a good one: the next try comes soon.
const GOOD_SESSION: Duration = Duration::from_secs(10);

/// How long a device's task waits for the store.
const STORE_WITHIN: Duration = Duration::from_secs(4);

/// What a device's task is told.
pub enum Order {
    /// Carry out a command of whoever has the lease.
    Command {
        /// What.
        command: Command,
        /// The lease that it was asked for under; none where it needs none.
        lease: Option<LeaseId>,
        /// What became of it.
        answer: Answer,
    },
    /// Push a lookup that was learned.
    News(Box<Lookup>),
}

/// Where the outcome of a command goes.
pub type Answer = oneshot::Sender<Result<Done, CommandError>>;

/// What all devices share.
#[derive(Clone)]
pub struct Context {
    /// The machine that all runs on.
    pub machine: Machine,
    /// The store.
    pub store: StoreThread,
    /// What devices did, on its way to the store.
    pub seconds: Arc<Seconds>,
    /// Learns from windows.
    pub learner: Arc<Learner>,
    /// Opens an address.
    pub open: Arc<OpenDevice>,
    /// Whether windows are for a fleet.
    pub trust: Arc<Trust>,
    /// Folder of recordings.
    pub recordings: PathBuf,
    /// Becomes true when the daemon stops.
    pub stop: watch::Receiver<bool>,
}

impl Context {
    /// Runs `f` with the store; none where it said no, which its thread tells, or takes too long: a device
    /// must not wait for a disk.
    pub async fn in_store<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Option<T> {
        let store = self.store.writing(Record::State);
        let done = tokio::time::timeout(STORE_WITHIN, store.run(f)).await;
        done.ok()?.ok()
    }

    /// Ready once the daemon stops.
    pub async fn stopping(&self) {
        // A daemon that is gone stops its devices, too.
        let _ = self.stop.clone().wait_for(|&stopping| stopping).await;
    }
}

/// The task of one device.
pub struct DeviceTask {
    /// The device as others see it.
    pub face: Arc<Face>,
    /// Where it is.
    pub address: Address,
    /// What all devices share.
    pub context: Context,
}

impl DeviceTask {
    /// Runs until the daemon stops.
    pub async fn run(&self, orders: &mut mpsc::Receiver<Order>) {
        let mut hasher = DefaultHasher::new();
        self.face.name.hash(&mut hasher);
        let mut backoff = Backoff::new(hasher.finish());
        while !self.is_stopping() {
            let wait = match self.connect(orders).await {
                Some(Ok(connection)) => {
                    let began = Instant::now();
                    let ended = self.keep_session(connection, orders).await;
                    if began.elapsed() > GOOD_SESSION {
                        backoff.reset();
                    }
                    let (state, detail) = match ended {
                        Ended::Stopping => return,
                        Ended::Slept(why) => (DeviceState::Suspended, why),
                        Ended::Link(why) => (DeviceState::Searching, why),
                    };
                    self.face.enter(state, &detail);
                    backoff.wait()
                }
                Some(Err(error)) => self.not_connected(&error, &mut backoff),
                None => return,
            };
            if !self.wait(wait, orders).await {
                return;
            }
        }
    }

    fn is_stopping(&self) -> bool {
        *self.context.stop.borrow()
    }

    /// The state that a failed try leaves, and how long to wait.
    fn not_connected(&self, error: &LinkError, backoff: &mut Backoff) -> Duration {
        match error {
            LinkError::Mismatch { .. } => {
                let why = error.to_string();
                self.face.lock().updates_needed = printable(&why);
                self.face.enter(DeviceState::Incompatible, &why);
                INCOMPATIBLE_EVERY
            }
            _ => {
                self.face.enter(DeviceState::Searching, &error.to_string());
                backoff.wait()
            }
        }
    }

    /// A connection, or why there is none; nothing when the daemon stops.
    async fn connect(&self, orders: &mut mpsc::Receiver<Order>) -> Option<Connected> {
        let (events, coming) = mpsc::channel(EVENTS);
        let (open, address) = (Arc::clone(&self.context.open), self.address.clone());
        let (tell, truth) = oneshot::channel();
        let opening = move || {
            let opened = open(&address)?;
            // Whoever asked is there until it is connected.
            let _ = tell.send(opened.truth);
            Ok(opened.transport)
        };
        let connecting = self.context.machine.connect(opening, events);
        tokio::select! {
            biased;
            connected = connecting => {
                let truth = match &connected {
                    Ok(_) => truth.await.ok().flatten(),
                    Err(_) => None,
                };
                Some(connected.map(|client| Connection { client, events: coming, truth }))
            }
            () = self.without_device(orders) => None,
        }
    }

    /// Waits; false when the daemon stops.
    async fn wait(&self, time: Duration, orders: &mut mpsc::Receiver<Order>) -> bool {
        tokio::select! {
            biased;
            () = tokio::time::sleep(time) => true,
            () = self.without_device(orders) => false,
        }
    }

    /// Answers orders while there is nobody to carry them out; returns when the daemon stops.
    async fn without_device(&self, orders: &mut mpsc::Receiver<Order>) {
        let mut tick = tokio::time::interval(Duration::from_millis(250));
        loop {
            tokio::select! {
                biased;
                () = self.context.stopping() => return,
                order = orders.recv() => match order {
                    None => return,
                    Some(Order::Command { command: Command::RecordStop, answer, .. }) => {
                        recording::stop(&self.face, answer);
                    }
                    Some(Order::Command { answer, .. }) => {
                        let _ = answer.send(Err(absent(&self.face)));
                    }
                    // It is offered again when the device is there.
                    Some(Order::News(news)) => self.learner_refused(news.lookup.version),
                },
                _ = tick.tick() => {
                    self.face.recorder.tick();
                    if let Some(holder) = self.face.lock().lease.expired(Instant::now()) {
                        lease_ended(&self.face, &holder);
                    }
                }
            }
        }
    }

    fn learner_refused(&self, version: u32) {
        self.context
            .learner
            .lookup_refused(&self.face.name, version);
    }

    async fn keep_session(
        &self,
        connection: Connection,
        orders: &mut mpsc::Receiver<Order>,
    ) -> Ended {
        let client = Arc::new(connection.client);
        {
            let mut inner = self.face.lock();
            inner.identity = Some(identity(client.hello()));
            inner.updates_needed = updates_needed(client.hello().protocol_minor);
            inner.connections = inner.connections.saturating_add(1);
            inner.client = Some(Arc::clone(&client));
            inner.last = None;
        }
        let mut session = Session::new(
            &self.face,
            &self.context,
            Arc::clone(&client),
            connection.truth,
        );
        let ended = session.run(connection.events, orders).await;
        session.close(&ended).await;
        drop(session);
        self.face.lock().client = None;
        if let Some(client) = Arc::into_inner(client) {
            // A port or an interface can be opened again only when it is closed.
            let _ = tokio::time::timeout(Duration::from_secs(5), client.close()).await;
        }
        ended
    }
}

type Connected = Result<Connection, LinkError>;

/// A device that was shaken hands with.
struct Connection {
    client: AsyncClient,
    events: mpsc::Receiver<ihd_link::Event>,
    /// What R and L truly are, where it is simulated here.
    truth: Option<Arc<TruthOf>>,
}

/// The answer for a device that is not connected.
pub fn absent(face: &Face) -> CommandError {
    let asked_w = face.lock().lease.asked_w();
    let mut detail = face.detail();
    if asked_w > 0 {
        detail += "; what was asked of it ends by itself within 10 s";
    }
    CommandError::NotConnected {
        name: face.name.clone(),
        detail,
    }
}

/// Tells that a lease has run out.
fn lease_ended(face: &Face, holder: &str) {
    tracing::info!(device = face.name, holder, "the lease has run out");
    face.tell(What::Lease {
        holder: String::new(),
        taken_from: String::new(),
        why: "it has run out".to_owned(),
    });
}
