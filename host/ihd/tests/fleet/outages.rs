//! Guarantees of server and client, on which the fleet relies, when the server is killed or cannot be reached.

use std::time::Duration;

use async_nats::jetstream::{self, stream};

use crate::cut::Cut;
use crate::server::Server;
use crate::site::PATIENCE;

/// Connects with time-outs of a second.
async fn connect(url: String) -> jetstream::Context {
    let options = async_nats::ConnectOptions::new().request_timeout(Some(Duration::from_secs(1)));
    let client = options.connect(url).await.unwrap();
    jetstream::ContextBuilder::new()
        .ack_timeout(Duration::from_secs(1))
        .build(client)
}

async fn make_stream(js: &jetstream::Context) {
    let config = stream::Config {
        name: "S".to_owned(),
        subjects: vec!["s".to_owned()],
        ..Default::default()
    };
    js.create_stream(config).await.unwrap();
}

/// Publishes once; returns the message's number if it was acknowledged.
async fn publish(js: &jetstream::Context) -> Option<u64> {
    let sent = js.publish("s", "x".into()).await.ok()?;
    sent.await.ok().map(|ack| ack.sequence)
}

/// Publishes until it is acknowledged.
async fn publish_at_last(js: &jetstream::Context) -> u64 {
    let deadline = tokio::time::Instant::now() + PATIENCE;
    loop {
        if let Some(sequence) = publish(js).await {
            return sequence;
        }
        assert!(tokio::time::Instant::now() < deadline, "not back");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_acknowledged_is_there_after_a_kill() {
    let mut server = Server::start("");
    let js = connect(server.url()).await;
    make_stream(&js).await;
    let mut acknowledged = 0;
    for _ in 0..3 {
        for _ in 0..20 {
            acknowledged = publish_at_last(&js).await;
        }
        server.kill9();
        assert_eq!(publish(&js).await, None);
        server.restart();
        let stream = js.get_stream_no_info("S").await.unwrap();
        let deadline = tokio::time::Instant::now() + PATIENCE;
        // The client reconnects by itself.
        let info = loop {
            match stream.get_info().await {
                Ok(info) => break info,
                Err(why) => assert!(tokio::time::Instant::now() < deadline, "{why}"),
            }
        };
        assert!(info.state.last_sequence >= acknowledged);
        assert_eq!(info.state.messages, info.state.last_sequence);
    }
    assert!(acknowledged >= 60);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_goes_on_after_a_partition_and_after_a_cut() {
    let server = Server::start("");
    let cut = Cut::start(server.address()).unwrap();
    let js = connect(cut.url()).await;
    make_stream(&js).await;
    assert_eq!(publish(&js).await, Some(1));
    cut.partition();
    assert_eq!(publish(&js).await, None);
    cut.heal();
    // The delayed one arrives, too.
    assert_eq!(publish_at_last(&js).await, 3);
    cut.drop_connections();
    let last = publish_at_last(&js).await;
    let info = js.get_stream("S").await.unwrap().get_info().await.unwrap();
    assert_eq!(info.state.messages, last);
}
