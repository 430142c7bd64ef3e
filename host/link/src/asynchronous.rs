//! Client on a thread of its own, for asynchronous programs.
//!
//! ```text
//!  with(f) ──► orders (a few) ──► thread: order, event, order, event … ──► events (bounded)
//!     ▲                             │ owns the Client
//!     └── what f returned ◄─────────┘
//! ```
//!
//! There is no second implementation: the thread runs the blocking [`Client`], and requests are closures. Time-outs are measured
//! with the transport's clock, as everywhere.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use ihd_shared::wire::messages::{FrontEnd, Hello};
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};
use tokio::sync::{mpsc, oneshot};
#[cfg(feature = "simulation")]
use tokio::time::{sleep, timeout};

use super::{Client, DeviceEvent, LinkError, Transport};

/// Time that the thread waits for an event before it checks for orders, on the transport's clock.
const EVENT_WAIT: Duration = Duration::from_millis(10);

/// Capacity of the queue of orders; a caller waits if it is full.
const ORDERS: usize = 8;

/// [`EVENT_WAIT`] for a simulated device: its frames may wait a little longer, which makes the simulation faster.
#[cfg(feature = "simulation")]
const SIMULATED_SLICE: Duration = Duration::from_millis(40);

/// Events that a simulated device may send within a slice.
#[cfg(feature = "simulation")]
const EVENTS_A_SLICE: usize = 8;

/// Capacity of the separate queue of requests to switch off; a caller waits if it is full.
const OFFS: usize = 8;

type Order = Box<dyn FnOnce(&mut Client) + Send>;

/// Client on a thread of its own. Dropping it ends the thread, which then closes the transport; [`AsyncClient::close`] waits for
/// that.
pub struct AsyncClient {
    orders: mpsc::Sender<Order>,
    offs: mpsc::Sender<Order>,
    closed: oneshot::Receiver<()>,
    end_reason: Arc<EndReason>,
    hello: Hello,
    front_end: FrontEnd,
    description: String,
    /// Set if a request takes as long on the runtime's clock as on the transport's.
    #[cfg(feature = "simulation")]
    takes_simulated_time: bool,
}

/// Error with which the thread has ended, for its caller.
type EndReason = Mutex<Option<Arc<LinkError>>>;

impl AsyncClient {
    /// Opens the transport and shakes hands, on the client's thread. Events of the device go to `events`, in order. While `events`
    /// is full, windows wait in the client as long as it has room, and telemetry is dropped; both are counted in
    /// [`super::ClientCounters::events_dropped`]. Once `events` has no receiver, events are dropped and not counted.
    ///
    /// A future that is dropped before it is ready leaves nothing open.
    ///
    /// # Errors
    /// Any error of `open` and [`Client::connect`]; [`LinkError::Connect`] if no thread can be started.
    pub async fn connect(
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<DeviceEvent>,
    ) -> Result<Self, LinkError> {
        let (serving, calling) = ServingSide::new(events);
        let serve = move || {
            if let Some((mut link_thread, lanes)) = serving.serve_behind(open) {
                let reason = link_thread.serve(lanes);
                link_thread.leave(reason);
            }
        };
        thread::Builder::new()
            .name("ihd-link".to_owned())
            .spawn(serve)
            .map_err(thread_start_error)?;
        calling.client().await
    }

    /// Connects like [`AsyncClient::connect`], but as a task of the calling runtime, without a thread: for a simulated device that
    /// never blocks, on a simulated clock. A request takes as long as the transport's clock says.
    ///
    /// # Errors
    /// Any error of [`AsyncClient::connect`].
    #[cfg(feature = "simulation")]
    pub async fn connect_simulated(
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<DeviceEvent>,
    ) -> Result<Self, LinkError> {
        let (serving, calling) = ServingSide::new(events);
        tokio::spawn(async move {
            if let Some((mut link_thread, lanes)) = serving.serve_behind(open) {
                let reason = link_thread.serve_simulated(lanes).await;
                link_thread.leave(reason);
            }
        });
        let mut client = calling.client().await?;
        client.takes_simulated_time = true;
        Ok(client)
    }

    /// Runs `f` with the client, between two events, and returns its result. Orders of one caller run in order. Dropping the future
    /// before its turn cancels the order.
    ///
    /// # Errors
    /// [`LinkError::Closed`] if the thread has ended or ends with this order (a panic); [`AsyncClient::ended`] has the reason.
    pub async fn with<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Client) -> T + Send + 'static,
    ) -> Result<T, LinkError> {
        let (answer, answered) = oneshot::channel();
        let order: Order = Box::new(move |client| {
            if !answer.is_closed() {
                let timed = timed(client, f);
                // The caller may have dropped its future.
                let _ = answer.send(timed);
            }
        });
        self.orders.send(order).await.map_err(|_| self.closed())?;
        self.answer(answered).await
    }

    /// Switches the device off like [`Client::off`], before all queued orders; an order whose answer does not come is preempted.
    /// `then` runs on the client's thread once the device has confirmed, before the next order. All this also happens if the future
    /// is dropped.
    ///
    /// # Errors
    /// Any error of [`Client::off`] and [`AsyncClient::with`].
    pub async fn off(&self, then: impl FnOnce() + Send + 'static) -> Result<(), LinkError> {
        let (answer, answered) = oneshot::channel();
        let order: Order = Box::new(move |client| {
            let timed = timed(client, Client::off);
            if timed.0.is_ok() {
                then();
            }
            // The caller may have dropped its future.
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

    /// Waits for the thread's result, and for the simulated time that it took.
    async fn answer<T>(&self, answered: oneshot::Receiver<(T, Duration)>) -> Result<T, LinkError> {
        let (outcome, _took) = answered.await.map_err(|_| self.closed())?;
        #[cfg(feature = "simulation")]
        if self.takes_simulated_time {
            sleep(_took).await;
        }
        Ok(outcome)
    }

    /// Reason why the thread has ended; `None` while it runs. The events' channel is closed then.
    pub fn ended(&self) -> Option<Arc<LinkError>> {
        lock(&self.end_reason).clone()
    }

    /// Hello of the device.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Scales of the codes of the device's channels.
    pub fn front_end(&self) -> &FrontEnd {
        &self.front_end
    }

    /// Device in words.
    pub fn describe(&self) -> &str {
        &self.description
    }

    /// Ends the thread and waits until it has closed the transport; only then can a port or an interface be opened again. An order
    /// under way is finished first.
    pub async fn close(self) {
        drop(self.orders);
        // Nothing is ever sent: the channel closes when the thread ends.
        let _ = self.closed.await;
    }
}

/// Runs `f` with the client; returns its result and the time taken on the transport's clock.
fn timed<T>(client: &mut Client, f: impl FnOnce(&mut Client) -> T) -> (T, Duration) {
    let began = client.clock();
    let outcome = f(client);
    (outcome, client.clock().saturating_sub(began))
}

fn is_used(lane: &mpsc::Sender<Order>) -> bool {
    lane.capacity() < lane.max_capacity()
}

fn thread_start_error(source: io::Error) -> LinkError {
    LinkError::Connect {
        device: "the device".to_owned(),
        hint: "; no thread could be started for it".to_owned(),
        source,
    }
}

/// Hello, front end and description of a device that shook hands.
type Greeting = (Hello, FrontEnd, String);

/// Receivers of the two queues of orders.
struct Lanes {
    orders: mpsc::Receiver<Order>,
    offs: mpsc::Receiver<Order>,
}

/// State of the thread before it has a client.
struct ServingSide {
    events: mpsc::Sender<DeviceEvent>,
    lanes: Lanes,
    /// Queue of requests to switch off; polled for pending ones.
    off_lane: mpsc::WeakSender<Order>,
    connected: oneshot::Sender<Result<Greeting, LinkError>>,
    closing: oneshot::Sender<()>,
    end_reason: Arc<EndReason>,
}

/// The caller's counterpart of a [`ServingSide`].
struct CallingSide {
    orders: mpsc::Sender<Order>,
    offs: mpsc::Sender<Order>,
    outcome: oneshot::Receiver<Result<Greeting, LinkError>>,
    closed: oneshot::Receiver<()>,
    end_reason: Arc<EndReason>,
}

impl ServingSide {
    fn new(events: mpsc::Sender<DeviceEvent>) -> (Self, CallingSide) {
        let (to_orders, orders) = mpsc::channel(ORDERS);
        let (to_offs, offs) = mpsc::channel(OFFS);
        let (connected, outcome) = oneshot::channel();
        let (closing, closed) = oneshot::channel::<()>();
        let end_reason = Arc::new(EndReason::default());
        let serving = Self {
            events,
            lanes: Lanes { orders, offs },
            off_lane: to_offs.downgrade(),
            connected,
            closing,
            end_reason: Arc::clone(&end_reason),
        };
        let calling = CallingSide {
            orders: to_orders,
            offs: to_offs,
            outcome,
            closed,
            end_reason,
        };
        (serving, calling)
    }

    /// Opens the transport and shakes hands.
    fn serve_behind(
        self,
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError>,
    ) -> Option<(LinkThread, Lanes)> {
        let mut client = match open().and_then(Client::connect) {
            Ok(client) => client,
            Err(error) => {
                // The caller may have dropped its future.
                let _ = self.connected.send(Err(error));
                return None;
            }
        };
        let lane = self.off_lane;
        client.yield_to_off(move || lane.upgrade().is_some_and(|lane| is_used(&lane)));
        let greeting = (
            client.hello().clone(),
            client.front_end().clone(),
            client.describe(),
        );
        self.connected.send(Ok(greeting)).ok()?;
        let link_thread = LinkThread {
            client,
            events: self.events,
            held: None,
            end_reason: self.end_reason,
            _closing: self.closing,
        };
        Some((link_thread, self.lanes))
    }
}

impl CallingSide {
    async fn client(self) -> Result<AsyncClient, LinkError> {
        let panicked = |_| thread_start_error(io::Error::other("it ended in a panic"));
        let (hello, front_end, description) = self.outcome.await.map_err(panicked)??;
        Ok(AsyncClient {
            orders: self.orders,
            offs: self.offs,
            closed: self.closed,
            end_reason: self.end_reason,
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

/// State of the thread.
struct LinkThread {
    client: Client,
    events: mpsc::Sender<DeviceEvent>,
    /// Next event, kept while the channel is full.
    held: Option<DeviceEvent>,
    end_reason: Arc<EndReason>,
    /// Last field: it must be dropped after the client has closed the transport.
    _closing: oneshot::Sender<()>,
}

impl Drop for LinkThread {
    /// Stores the reason before the events' channel closes, like every other end.
    fn drop(&mut self) {
        if thread::panicking() {
            self.leave(LinkError::Panicked);
        }
    }
}

impl LinkThread {
    fn leave(&self, reason: LinkError) {
        *lock(&self.end_reason) = Some(Arc::new(reason));
    }

    /// Runs orders and passes events in turn until the link fails or the client is dropped; requests to switch off run before each
    /// order.
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
                EVENT_WAIT
            } else {
                Duration::ZERO
            };
            if let Err(reason) = self.pass_on(slice) {
                return reason;
            }
        }
    }

    /// Runs like [`LinkThread::serve`], on the runtime's clock.
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

    /// Passes one event like [`LinkThread::event`]; an error of the recording does not end the link: its sink reports it.
    fn pass_on(&mut self, slice: Duration) -> Result<(), LinkError> {
        match self.event(slice) {
            Err(LinkError::Recording(_)) => Ok(()),
            other => other,
        }
    }

    /// Passes on the next event, or waits for one at most `slice`.
    fn event(&mut self, slice: Duration) -> Result<(), LinkError> {
        let event = match self.held.take() {
            Some(event) => Some(event),
            None => self.client.next_event(slice)?,
        };
        let Some(event) = event else { return Ok(()) };
        match self.events.try_send(event) {
            Ok(()) | Err(TrySendError::Closed(_)) => Ok(()),
            Err(TrySendError::Full(DeviceEvent::Telemetry(_))) => {
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
