//! The client on a thread of its own, for programs that wait with futures.
//!
//! ```text
//!  with(f) ──► orders (a few) ──► thread: order, event, order, event … ──► events (bounded)
//!     ▲                             │ owns the Client
//!     └── what f returned ◄─────────┘
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
#[cfg(feature = "simulation")]
use tokio::time::{sleep, timeout};

use super::{Client, Event, LinkError, Transport};

/// How long the thread waits for an event before it looks for an order, on the transport's clock.
const SLICE: Duration = Duration::from_millis(10);

/// Orders that may wait; whoever gives one more waits for room.
const ORDERS: usize = 8;

/// As [`SLICE`] for a simulated device, whose frames may wait a little longer for a faster simulation.
#[cfg(feature = "simulation")]
const SIMULATED_SLICE: Duration = Duration::from_millis(40);

/// Events that a simulated device may send within a slice.
#[cfg(feature = "simulation")]
const EVENTS_A_SLICE: usize = 8;

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
    /// A request takes as long on the runtime's clock as it took on the transport's.
    #[cfg(feature = "simulation")]
    takes_simulated_time: bool,
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
        let (serving, calling) = ServingSide::new(events);
        let serve = move || {
            if let Some((mut served, lanes)) = serving.serve_behind(open) {
                let reason = served.serve(lanes);
                served.leave(reason);
            }
        };
        thread::Builder::new()
            .name("ihd-link".to_owned())
            .spawn(serve)
            .map_err(no_thread)?;
        calling.client().await
    }

    /// As [`AsyncClient::connect`], on the runtime that calls it and without a thread: for a simulated device that never blocks, on a
    /// simulated clock. A request takes as long as the transport's clock says.
    ///
    /// # Errors
    /// As [`AsyncClient::connect`].
    #[cfg(feature = "simulation")]
    pub async fn connect_simulated(
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<Event>,
    ) -> Result<Self, LinkError> {
        let (serving, calling) = ServingSide::new(events);
        tokio::spawn(async move {
            if let Some((mut served, lanes)) = serving.serve_behind(open) {
                let reason = served.serve_simulated(lanes).await;
                served.leave(reason);
            }
        });
        let mut client = calling.client().await?;
        client.takes_simulated_time = true;
        Ok(client)
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
                let timed = timed(client, f);
                // Whoever left meanwhile does not want to know.
                let _ = answer.send(timed);
            }
        });
        self.orders.send(order).await.map_err(|_| self.closed())?;
        self.answer(answered).await
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
            let timed = timed(client, Client::off);
            if timed.0.is_ok() {
                then();
            }
            // Whoever left meanwhile does not want to know.
            let _ = answer.send(timed);
        });
        self.offs.send(order).await.map_err(|_| self.closed())?;
        self.answer(answered).await?
    }

    fn closed(&self) -> LinkError {
        LinkError::Closed {
            device: self.description.clone(),
        }
    }

    /// What the thread answers, and the time that it took.
    async fn answer<T>(&self, answered: oneshot::Receiver<(T, Duration)>) -> Result<T, LinkError> {
        let (outcome, _took) = answered.await.map_err(|_| self.closed())?;
        #[cfg(feature = "simulation")]
        if self.takes_simulated_time {
            sleep(_took).await;
        }
        Ok(outcome)
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

/// Runs `f` with the client; what it returned, and how long it took on the transport's clock.
fn timed<T>(client: &mut Client, f: impl FnOnce(&mut Client) -> T) -> (T, Duration) {
    let began = client.clock();
    let outcome = f(client);
    (outcome, client.clock().saturating_sub(began))
}

fn is_used(lane: &mpsc::Sender<Order>) -> bool {
    lane.capacity() < lane.max_capacity()
}

fn no_thread(source: io::Error) -> LinkError {
    LinkError::Connect {
        device: "the device".to_owned(),
        hint: "; no thread could be started for it".to_owned(),
        source,
    }
}

/// Hello, front end and description of a device that shook hands.
type Greeting = (Hello, FrontEnd, String);

/// What is asked of the client.
struct Lanes {
    orders: mpsc::Receiver<Order>,
    offs: mpsc::Receiver<Order>,
}

/// What the thread needs before it has a client.
struct ServingSide {
    events: mpsc::Sender<Event>,
    lanes: Lanes,
    /// The lane of what switches off, to look whether it is used.
    off_lane: mpsc::WeakSender<Order>,
    connected: oneshot::Sender<Result<Greeting, LinkError>>,
    closing: oneshot::Sender<()>,
    last_words: Arc<LastWords>,
}

/// The caller's counterpart of a [`ServingSide`].
struct CallingSide {
    orders: mpsc::Sender<Order>,
    offs: mpsc::Sender<Order>,
    outcome: oneshot::Receiver<Result<Greeting, LinkError>>,
    closed: oneshot::Receiver<()>,
    last_words: Arc<LastWords>,
}

impl ServingSide {
    fn new(events: mpsc::Sender<Event>) -> (Self, CallingSide) {
        let (to_orders, orders) = mpsc::channel(ORDERS);
        let (to_offs, offs) = mpsc::channel(OFFS);
        let (connected, outcome) = oneshot::channel();
        let (closing, closed) = oneshot::channel::<()>();
        let last_words = Arc::new(LastWords::default());
        let serving = Self {
            events,
            lanes: Lanes { orders, offs },
            off_lane: to_offs.downgrade(),
            connected,
            closing,
            last_words: Arc::clone(&last_words),
        };
        let calling = CallingSide {
            orders: to_orders,
            offs: to_offs,
            outcome,
            closed,
            last_words,
        };
        (serving, calling)
    }

    /// Opens the transport and shakes hands.
    fn serve_behind(
        self,
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError>,
    ) -> Option<(Served, Lanes)> {
        let mut client = match open().and_then(Client::connect) {
            Ok(client) => client,
            Err(error) => {
                // Whoever asked has left.
                let _ = self.connected.send(Err(error));
                return None;
            }
        };
        let lane = self.off_lane;
        client.give_way_to_off(move || lane.upgrade().is_some_and(|lane| is_used(&lane)));
        let greeting = (
            client.hello().clone(),
            client.front_end().clone(),
            client.describe(),
        );
        self.connected.send(Ok(greeting)).ok()?;
        let served = Served {
            client,
            events: self.events,
            held: None,
            last_words: self.last_words,
            _closing: self.closing,
        };
        Some((served, self.lanes))
    }
}

impl CallingSide {
    async fn client(self) -> Result<AsyncClient, LinkError> {
        let panicked = |_| no_thread(io::Error::other("it ended in a panic"));
        let (hello, front_end, description) = self.outcome.await.map_err(panicked)??;
        Ok(AsyncClient {
            orders: self.orders,
            offs: self.offs,
            closed: self.closed,
            last_words: self.last_words,
            hello,
            front_end,
            description,
            #[cfg(feature = "simulation")]
            takes_simulated_time: false,
        })
    }
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
    /// The last field, so that it is dropped once the client has closed the transport.
    _closing: oneshot::Sender<()>,
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
    fn serve(&mut self, mut lanes: Lanes) -> LinkError {
        loop {
            while let Ok(off) = lanes.offs.try_recv() {
                off(&mut self.client);
            }
            match lanes.orders.try_recv() {
                Ok(order) => order(&mut self.client),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => {
                    return LinkError::Closed {
                        device: self.client.describe(),
                    };
                }
            }
            let slice = if lanes.orders.is_empty() && lanes.offs.is_empty() {
                SLICE
            } else {
                Duration::ZERO
            };
            if let Err(reason) = self.pass_on(slice) {
                return reason;
            }
        }
    }

    /// As [`Served::serve`], on the runtime's clock.
    #[cfg(feature = "simulation")]
    async fn serve_simulated(&mut self, mut lanes: Lanes) -> LinkError {
        loop {
            let next = timeout(SIMULATED_SLICE, async {
                tokio::select! {
                    biased;
                    off = lanes.offs.recv() => off,
                    order = lanes.orders.recv() => order,
                }
            });
            match next.await {
                Ok(Some(order)) => {
                    let ((), took) = timed(&mut self.client, order);
                    sleep(took).await;
                }
                Ok(None) => {
                    return LinkError::Closed {
                        device: self.client.describe(),
                    };
                }
                Err(_) => {}
            }
            for _ in 0..EVENTS_A_SLICE {
                if let Err(reason) = self.pass_on(Duration::ZERO) {
                    return reason;
                }
            }
        }
    }

    /// As [`Served::event`]; a recording that fails does not end the link.
    fn pass_on(&mut self, slice: Duration) -> Result<(), LinkError> {
        match self.event(slice) {
            Err(failure @ LinkError::Recording(_)) => {
                *lock(&self.last_words.recording) = Some(failure);
                Ok(())
            }
            other => other,
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
