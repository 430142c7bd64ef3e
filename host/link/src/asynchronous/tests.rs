use std::sync::atomic::{AtomicBool, Ordering};

use ihd_shared::wire::messages::{AnyMessage, FaultEvent, Telemetry};

use super::super::fake::{Fake, Sent, hello};
use super::*;

/// Answers hellos, and says "done" to `SetPower`.
fn obedient(message: &AnyMessage<'_>, sent: &mut Sent) {
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

fn opened(fake: Fake) -> impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send {
    move || Ok(Box::new(fake) as _)
}

#[tokio::test]
async fn orders_and_events_take_turns() {
    let mut told = 0;
    let fake = Fake::new(obedient, move |sent| {
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
        let Some(Event::Fault(event)) = events.recv().await else {
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
    let fake = Fake::new(obedient, {
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
    let mute = Fake::new(|_, _| {}, |_| {});
    let error = AsyncClient::connect(opened(mute), sender).await.err();
    assert!(
        matches!(error, Some(LinkError::NoAnswer { .. })),
        "{error:?}"
    );
}

#[tokio::test]
async fn a_reader_that_sleeps_costs_telemetry_and_nothing_else() {
    let mut told = 0;
    let fake = Fake::new(obedient, move |sent| {
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
    assert!(matches!(events.recv().await, Some(Event::Telemetry(_))));
}

#[tokio::test]
async fn all_events_that_are_neither_dropped_nor_counted_arrive() {
    let (mut told, all) = (0, 3_000);
    let fake = Fake::new(obedient, move |sent| {
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
            Some(Event::Fault(event)) => {
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
    struct Watched(Fake);
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
        Ok(Box::new(Watched(Fake::new(obedient, |_| {}))) as _)
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
    let fake = Fake::new(obedient, |_| {});
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
    let fake = Fake::new(obedient, |_| {});
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
