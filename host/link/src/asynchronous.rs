//! The client on a thread of its own, for programs that wait with futures.
//!
//! ```text
//!  with(f) ──► orders (a few) ──► thread: order, event, order, event … ──► events (bounded)
//!     ▲                             │ owns the Client    ▲
//!     └── what f returned ◄─────────┘                    └── before each, and beside an answer that stays away: off()
//! ```
//!
//! There is no second client: the thread runs the blocking [`Client`], and what is asked of it is a
//! closure. Time-outs are measured with the transport's clock, as everywhere.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use ihd_shared::wire::messages::{FrontEnd, Hello};
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};
use tokio::sync::{mpsc, oneshot};

use super::{Client, Event, LinkError, Transport};

/// How long the thread waits for an event before it looks for an order, on the transport's clock.
const SLICE: Duration = Duration::from_millis(10);

/// Orders that may wait; whoever gives one more waits for room.
const ORDERS: usize = 8;

/// Requests to switch off that may wait, on a lane of their own; whoever makes one more waits for room.
const OFFS: usize = 8;

type Order = Box<dyn FnOnce(&mut Client) + Send>;

/// A client on a thread of its own. Dropping it ends the thread, which then closes the transport;
/// [`AsyncClient::close`] waits for that.
pub struct AsyncClient {
    orders: mpsc::Sender<Order>,
    offs: mpsc::Sender<Order>,
    closed: oneshot::Receiver<()>,
    last_words: Arc<LastWords>,
    hello: Hello,
    front_end: FrontEnd,
    description: String,
}

/// What the thread leaves behind.
#[derive(Default)]
struct LastWords {
    ended: Mutex<Option<Arc<LinkError>>>,
    recording: Mutex<Option<LinkError>>,
}

impl AsyncClient {
    /// Opens the transport and shakes hands, on the client's thread. What the device sends of its own
    /// accord goes to `events`, in its order. While `events` is full, windows wait in the client as far as
    /// it has room, and telemetry is dropped; both show in [`super::Counters::events_dropped`]. Once
    /// nobody receives them, events are dropped and not counted.
    ///
    /// A future that is dropped before it is ready leaves nothing open.
    ///
    /// # Errors
    /// As `open` and [`Client::connect`]; [`LinkError::Connect`] when there is no thread to be had.
    pub async fn connect(
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<Event>,
    ) -> Result<Self, LinkError> {
        let (orders, waiting) = mpsc::channel(ORDERS);
        let (offs, offs_waiting) = mpsc::channel(OFFS);
        let lane = offs.downgrade();
        let (connected, outcome) = oneshot::channel();
        let (closing, closed) = oneshot::channel::<()>();
        let last_words = Arc::new(LastWords::default());
        let heir = Arc::clone(&last_words);
        let serve = move || {
            // Dropped last, when the transport is closed.
            let _closing = closing;
            let mut client = match open().and_then(Client::connect) {
                Ok(client) => client,
                Err(error) => return drop(connected.send(Err(error))),
            };
            client.give_way_to_off(move || lane.upgrade().is_some_and(|lane| is_used(&lane)));
            let told = (
                client.hello().clone(),
                client.front_end().clone(),
                client.describe(),
            );
            if connected.send(Ok(told)).is_ok() {
                let mut served = Served {
                    client,
                    events,
                    held: None,
                    last_words: heir,
                };
                let reason = served.serve(waiting, offs_waiting);
                served.leave(reason);
            }
        };
        let no_thread = |source| LinkError::Connect {
            device: "the device".to_owned(),
            hint: "; no thread could be started for it".to_owned(),
            source,
        };
        thread::Builder::new()
            .name("ihd-link".to_owned())
            .spawn(serve)
            .map_err(no_thread)?;
        let panicked = |_| no_thread(io::Error::other("it ended in a panic"));
        let (hello, front_end, description) = outcome.await.map_err(panicked)??;
        Ok(Self {
            orders,
            offs,
            closed,
            last_words,
            hello,
            front_end,
            description,
        })
    }

    /// Runs `f` with the client, between two events, and gives what it returned. Orders of one caller
    /// run in the order given. A future that is dropped before its turn takes its order with it: what was
    /// given up is not done later.
    ///
    /// # Errors
    /// [`LinkError::Closed`] when the thread has ended, or ended with this order (a panic);
    /// [`AsyncClient::ended`] has the reason.
    pub async fn with<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Client) -> T + Send + 'static,
    ) -> Result<T, LinkError> {
        let (answer, answered) = oneshot::channel();
        let order: Order = Box::new(move |client| {
            if !answer.is_closed() {
                // Whoever left meanwhile does not want to know.
                let _ = answer.send(f(client));
            }
        });
        let closed = || LinkError::Closed {
            device: self.description.clone(),
        };
        self.orders.send(order).await.map_err(|_| closed())?;
        answered.await.map_err(|_| closed())
    }

    /// Switches the device off before all orders that wait, as [`Client::off`]; an order under way gives way where its answer stays
    /// away. `then` runs on the client's thread once the device has confirmed, before the next order. It is done even where
    /// the future is dropped.
    ///
    /// # Errors
    /// As [`Client::off`] and [`AsyncClient::with`].
    pub async fn off(&self, then: impl FnOnce() + Send + 'static) -> Result<(), LinkError> {
        let (answer, answered) = oneshot::channel();
        let order: Order = Box::new(move |client| {
            let off = client.off();
            if off.is_ok() {
                then();
            }
            // Whoever left meanwhile does not want to know.
            let _ = answer.send(off);
        });
        let closed = || LinkError::Closed {
            device: self.description.clone(),
        };
        self.offs.send(order).await.map_err(|_| closed())?;
        answered.await.map_err(|_| closed())?
    }

    /// Why the thread ended, once it has: the events' channel is closed then.
    pub fn ended(&self) -> Option<Arc<LinkError>> {
        lock(&self.last_words.ended).clone()
    }

    /// Why a recording begun with [`Client::record_to`] stopped, once; the link went on.
    pub fn take_recording_failure(&self) -> Option<LinkError> {
        lock(&self.last_words.recording).take()
    }

    /// How the device described itself.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// What the codes of the device's channels stand for.
    pub fn front_end(&self) -> &FrontEnd {
        &self.front_end
    }

    /// The device in words.
    pub fn describe(&self) -> &str {
        &self.description
    }

    /// Ends the thread and waits until it has closed the transport: only then a port or an interface
    /// can be opened again. An order under way is finished first.
    pub async fn close(self) {
        drop(self.orders);
        // Nothing is ever sent: this ends when the thread has.
        let _ = self.closed.await;
    }
}

fn is_used(lane: &mpsc::Sender<Order>) -> bool {
    lane.capacity() < lane.max_capacity()
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread's side.
struct Served {
    client: Client,
    events: mpsc::Sender<Event>,
    /// The next event, which found its channel full.
    held: Option<Event>,
    last_words: Arc<LastWords>,
}

impl Drop for Served {
    /// Before the events' channel closes, as with every other reason.
    fn drop(&mut self) {
        if thread::panicking() {
            self.leave(LinkError::Panicked);
        }
    }
}

impl Served {
    fn leave(&self, reason: LinkError) {
        *lock(&self.last_words.ended) = Some(Arc::new(reason));
    }

    /// Orders and events in turn, until the link fails or nobody gives orders any more; what switches off comes before each.
    fn serve(
        &mut self,
        mut orders: mpsc::Receiver<Order>,
        mut offs: mpsc::Receiver<Order>,
    ) -> LinkError {
        loop {
            while let Ok(off) = offs.try_recv() {
                off(&mut self.client);
            }
            match orders.try_recv() {
                Ok(order) => order(&mut self.client),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => {
                    return LinkError::Closed {
                        device: self.client.describe(),
                    };
                }
            }
            let slice = if orders.is_empty() && offs.is_empty() {
                SLICE
            } else {
                Duration::ZERO
            };
            match self.event(slice) {
                Ok(()) => {}
                // The link goes on.
                Err(failure @ LinkError::Recording(_)) => {
                    *lock(&self.last_words.recording) = Some(failure);
                }
                Err(reason) => return reason,
            }
        }
    }

    /// Passes the next event on, or waits for one at most `slice` long.
    fn event(&mut self, slice: Duration) -> Result<(), LinkError> {
        let event = match self.held.take() {
            Some(event) => Some(event),
            None => self.client.next_event(slice)?,
        };
        let Some(event) = event else { return Ok(()) };
        match self.events.try_send(event) {
            Ok(()) | Err(TrySendError::Closed(_)) => Ok(()),
            Err(TrySendError::Full(Event::Telemetry(_))) => {
                self.client.count_dropped_event();
                Ok(())
            }
            Err(TrySendError::Full(event)) => {
                self.held = Some(event);
                self.client.wait_without_events(slice)
            }
        }
    }
}

#[cfg(test)]
mod tests;
