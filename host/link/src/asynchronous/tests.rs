use std::sync::atomic::{AtomicBool, Ordering};

use ihd_shared::wire::messages::{AnyMessage, FaultEvent, SetPower, Telemetry};

use super::super::fake::{FakeDevice, FakeOutput, hello};
use super::*;

/// Answers hellos, and says "done" to `SetPower`.
fn obedient(message: &AnyMessage<'_>, sent: &mut FakeOutput) {
    match message {
        AnyMessage::Hello(_) => sent.greet(),
        AnyMessage::SetPower(_) => sent.done(),
        _ => {}
    }
}

fn fault(half_cycle: u32) -> FaultEvent {
    let fault = ihd_shared::fault::Fault::NONE;
    FaultEvent { half_cycle, fault }
}

fn telemetry(seq: u32) -> Telemetry {
    let zeros = [0; 64];
    let (mut telemetry, _): (Telemetry, _) = postcard::take_from_bytes(&zeros).unwrap();
    telemetry.seq = seq;
    telemetry
}

fn opened(fake: FakeDevice) -> impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send {
    move || Ok(Box::new(fake) as _)
}

#[tokio::test]
async fn orders_and_events_take_turns() {
    let mut told = 0;
    let fake = FakeDevice::new(obedient, move |sent| {
        told += 1;
        sent.message(&fault(told));
    });
    let (sender, mut events) = mpsc::channel(4);
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    assert_eq!(client.hello(), &hello());
    assert_eq!(client.describe(), "fake");
    let mut next = None;
    for _ in 0..20 {
        client.with(|c| c.set_power(500)).await.unwrap().unwrap();
        let Some(DeviceEvent::Fault(event)) = events.recv().await else {
            panic!("no event");
        };
        assert!(next.is_none_or(|next| next == event.half_cycle));
        next = Some(event.half_cycle + 1);
    }
    assert!(client.ended().is_none());
    client.close().await;
    while events.recv().await.is_some() {}
}

#[tokio::test]
async fn the_reason_outlives_the_thread() {
    let fake = FakeDevice::new(obedient, {
        let mut waited = 0;
        move |sent| {
            waited += 1;
            sent.closed = waited > 5;
        }
    });
    let (sender, mut events) = mpsc::channel(4);
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    assert!(events.recv().await.is_none());
    assert!(matches!(
        client.ended().as_deref(),
        Some(LinkError::Closed { .. })
    ));
    let refused = client.with(|c| c.set_power(500)).await;
    assert!(matches!(refused, Err(LinkError::Closed { .. })));
}

#[tokio::test]
async fn what_cannot_be_opened_is_said() {
    let (sender, _events) = mpsc::channel(4);
    let closed = || {
        Err(LinkError::Closed {
            device: "nowhere".into(),
        })
    };
    let error = AsyncClient::connect(closed, sender).await.err().unwrap();
    assert!(error.to_string().contains("nowhere"), "{error}");
    let (sender, _events) = mpsc::channel(4);
    let mute = FakeDevice::new(|_, _| {}, |_| {});
    let error = AsyncClient::connect(opened(mute), sender).await.err();
    assert!(
        matches!(error, Some(LinkError::NoAnswer { .. })),
        "{error:?}"
    );
}

#[tokio::test]
async fn a_reader_that_sleeps_costs_telemetry_and_nothing_else() {
    let mut told = 0;
    let fake = FakeDevice::new(obedient, move |sent| {
        if told < 1_000 {
            sent.message(&telemetry(told));
            if told.is_multiple_of(10) {
                sent.message(&fault(told));
            }
            told += 1;
        }
    });
    let (sender, mut events) = mpsc::channel(2);
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    let counters = loop {
        let counters = client.with(|c| c.counters()).await.unwrap();
        let faults = counters.frames_good - counters.telemetry.received - 2;
        if counters.telemetry.received == 1_000 && faults == 100 {
            break counters;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    // Nobody has read: two are in the channel, one is held, the rest waits or was dropped.
    assert!(counters.events_dropped > 0);
    client.close().await;
    assert!(matches!(
        events.recv().await,
        Some(DeviceEvent::Telemetry(_))
    ));
}

#[tokio::test]
async fn all_events_that_are_neither_dropped_nor_counted_arrive() {
    let (mut told, all) = (0, 3_000);
    let fake = FakeDevice::new(obedient, move |sent| {
        if told < all {
            sent.message(&telemetry(told));
            sent.message(&fault(told));
            told += 1;
        }
    });
    let (sender, mut events) = mpsc::channel(8);
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    let (mut faults, mut telemetries) = (0, 0);
    while faults < all {
        match events.recv().await {
            Some(DeviceEvent::Fault(event)) => {
                assert_eq!(event.half_cycle, faults, "a fault was lost");
                faults += 1;
            }
            Some(_) => telemetries += 1,
            None => panic!("{:?}", client.ended()),
        }
        if faults.is_multiple_of(1_000) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
    let dropped = client.with(|c| c.counters().events_dropped).await.unwrap();
    assert_eq!(telemetries + dropped, all);
}

#[tokio::test]
async fn a_dropped_client_closes_its_transport() {
    static OPEN: AtomicBool = AtomicBool::new(false);
    struct Watched(FakeDevice);
    impl Drop for Watched {
        fn drop(&mut self) {
            OPEN.store(false, Ordering::SeqCst);
        }
    }
    impl Transport for Watched {
        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            self.0.send(bytes)
        }
        fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
            self.0.receive(buf, timeout)
        }
        fn describe(&self) -> String {
            self.0.describe()
        }
    }
    let open = || {
        OPEN.store(true, Ordering::SeqCst);
        Ok(Box::new(Watched(FakeDevice::new(obedient, |_| {}))) as _)
    };
    let (sender, mut events) = mpsc::channel(4);
    let client = AsyncClient::connect(open, sender).await.unwrap();
    assert!(OPEN.load(Ordering::SeqCst));
    client.close().await;
    assert!(!OPEN.load(Ordering::SeqCst));
    assert!(events.recv().await.is_none());
}

#[tokio::test]
async fn an_order_that_panics_ends_the_thread_with_a_reason() {
    let (sender, mut events) = mpsc::channel(4);
    let fake = FakeDevice::new(obedient, |_| {});
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    let order = client.with(|_| panic!("on purpose")).await;
    assert!(matches!(order, Err(LinkError::Closed { .. })));
    assert!(events.recv().await.is_none());
    assert!(matches!(
        client.ended().as_deref(),
        Some(LinkError::Panicked)
    ));
}

#[tokio::test]
async fn an_order_that_was_given_up_is_not_done_later() {
    static DONE: AtomicBool = AtomicBool::new(false);
    let (sender, _events) = mpsc::channel(4);
    let fake = FakeDevice::new(obedient, |_| {});
    let client = AsyncClient::connect(opened(fake), sender).await.unwrap();
    let slow = client.with(|_| std::thread::sleep(Duration::from_millis(200)));
    let late = async {
        let order = client.with(|_| DONE.store(true, Ordering::SeqCst));
        tokio::time::timeout(Duration::from_millis(20), order).await
    };
    let (slow, late) = tokio::join!(slow, late);
    assert!(slow.is_ok() && late.is_err());
    client.with(|_| ()).await.unwrap();
    assert!(!DONE.load(Ordering::SeqCst));
}

/// Requests that a device has received, by name and power.
type Told = Arc<Mutex<Vec<(&'static str, u16)>>>;

/// A device that notes what it is told and answers hellos and offs alone. Its clock stands still until it is switched off: whoever waits
/// for another answer waits for ever.
struct Stubborn {
    device: FakeDevice,
    told: Told,
    runs_off: Arc<AtomicBool>,
}

impl Stubborn {
    fn new() -> Self {
        let (told, runs_off) = (Told::default(), Arc::new(AtomicBool::new(false)));
        let (noted, off) = (Arc::clone(&told), Arc::clone(&runs_off));
        let on_message = move |message: &AnyMessage<'_>, sent: &mut FakeOutput| match message {
            AnyMessage::SetPower(SetPower { power_w }) => {
                lock(&noted).push(("SetPower", *power_w));
                if *power_w == 0 {
                    off.store(true, Ordering::Relaxed);
                    sent.done();
                }
            }
            AnyMessage::GetStatus(_) => lock(&noted).push(("GetStatus", 0)),
            other => obedient(other, sent),
        };
        Self {
            device: FakeDevice::new(on_message, |_| {}),
            told,
            runs_off,
        }
    }
}

impl Transport for Stubborn {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.device.send(bytes)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        self.device.receive(buf, timeout)
    }

    fn describe(&self) -> String {
        self.device.describe()
    }

    fn clock(&self) -> Duration {
        match self.runs_off.load(Ordering::Relaxed) {
            true => self.device.clock(),
            false => Duration::ZERO,
        }
    }
}

/// Waits until the device was told something; the limit only ends a hang.
async fn until_told(told: &Told, what: (&'static str, u16)) {
    for _ in 0..60_000 {
        if lock(told).contains(&what) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("not told {what:?}: {:?}", lock(told));
}

#[tokio::test]
async fn off_overtakes_the_orders_that_wait_and_the_one_whose_answer_stays_away() {
    let device = Stubborn::new();
    let told = Arc::clone(&device.told);
    let (sender, _events) = mpsc::channel(4);
    let open = move || Ok(Box::new(device) as Box<dyn Transport>);
    let client = Arc::new(AsyncClient::connect(open, sender).await.unwrap());
    let short = |client: &mut Client| client.set_timeout(Duration::from_millis(60));
    client.with(short).await.unwrap();
    // More than there is room for.
    let asked: Vec<_> = (0..2 * ORDERS)
        .map(|_| {
            let client = Arc::clone(&client);
            tokio::spawn(async move { client.with(|c| c.status().map(drop)).await.unwrap() })
        })
        .collect();
    until_told(&told, ("GetStatus", 0)).await;
    let noted = Arc::clone(&told);
    let confirmed = move || lock(&noted).push(("confirmed", 0));
    client.off(confirmed).await.unwrap();
    let so_far = lock(&told).clone();
    let off = ("SetPower", 0);
    assert_eq!(so_far[..4], [("GetStatus", 0), off, off, ("confirmed", 0)]);
    let mut gave_way = 0;
    for status in asked {
        let error = status.await.unwrap().unwrap_err();
        gave_way += u32::from(matches!(error, LinkError::Preempted { .. }));
    }
    assert_eq!(gave_way, 1, "the others had their turn afterwards");
}

#[tokio::test]
async fn power_that_an_off_overtakes_is_not_asked_for_again() {
    let device = Stubborn::new();
    let told = Arc::clone(&device.told);
    let (sender, _events) = mpsc::channel(4);
    let open = move || Ok(Box::new(device) as Box<dyn Transport>);
    let client = Arc::new(AsyncClient::connect(open, sender).await.unwrap());
    let asking = Arc::clone(&client);
    let power = tokio::spawn(async move { asking.with(|c| c.set_power(900)).await.unwrap() });
    until_told(&told, ("SetPower", 900)).await;
    // Whoever asks looks once and leaves, as a rule before the answer: it is switched off all the same.
    let off = client.off(|| ());
    let _ = tokio::time::timeout(Duration::ZERO, off).await;
    let error = power.await.unwrap().unwrap_err();
    assert!(matches!(error, LinkError::Preempted { .. }), "{error}");
    client.with(|_| ()).await.unwrap();
    let off = ("SetPower", 0);
    assert_eq!(*lock(&told), [("SetPower", 900), off, off]);
}
