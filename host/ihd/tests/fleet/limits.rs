//! Limits of the fleet on the server, and files that do not fit.

use std::fs;

use async_nats::jetstream::{self, Context};
use ihd_fleet::names;

use super::server::Server;
use super::site::{fleet, init};

async fn state(js: &Context, stream: &str) -> (u64, u64, i64) {
    let mut stream = js.get_stream(stream).await.unwrap();
    let info = stream.info().await.unwrap();
    (info.state.messages, info.state.bytes, info.config.max_bytes)
}

#[tokio::test]
async fn init_again_keeps_messages_and_limits() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &["--threads", "8"]);
    let js = jetstream::new(async_nats::connect(&url).await.unwrap());
    for seq in 0..30 {
        let subject = names::result("bench", 1, seq);
        let sent = js.publish(subject, vec![0; 50_000].into()).await.unwrap();
        sent.await.unwrap();
    }
    let before = state(&js, names::RESULTS).await;
    assert_eq!((before.0, before.2), (30, 200_000_000));
    // The limit of results is below what is there: nothing is changed, not even the windows' limit.
    let (text, code) = fleet(
        &url,
        &[
            "init",
            "--results-bytes",
            "500000",
            "--windows-bytes",
            "400000000",
        ],
    );
    assert!(
        code != 0 && text.contains("deletes nothing"),
        "{code} {text}"
    );
    assert_eq!(state(&js, names::RESULTS).await, before);
    assert_eq!(state(&js, names::WINDOWS).await.2, 500_000_000);
    // Another edge: all limits stay.
    let (text, code) = fleet(&url, &["init", "--edge", "new=hob"]);
    assert_eq!(code, 0, "{text}");
    assert_eq!(state(&js, names::RESULTS).await, before);
    assert_eq!(state(&js, names::WINDOWS).await.2, 500_000_000);
    let mut workers = js
        .get_consumer_from_stream::<jetstream::consumer::pull::Config, _, _>(
            names::WORKERS,
            names::WINDOWS,
        )
        .await
        .unwrap();
    assert_eq!(workers.info().await.unwrap().config.max_ack_pending, 16);
    // The object store's limit applies to one that is there.
    let (text, code) = fleet(&url, &["init", "--captures-bytes", "3000000"]);
    assert_eq!(code, 0, "{text}");
    assert_eq!(state(&js, names::CAPTURES_STREAM).await.2, 3_000_000);
}

#[tokio::test]
async fn a_failed_upload_leaves_nothing() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let (text, code) = fleet(&url, &["init", "--captures-bytes", "2000000"]);
    assert_eq!(code, 0, "{text}");
    let js = jetstream::new(async_nats::connect(&url).await.unwrap());
    let file = |name: &str, bytes: u32| {
        let path = server.folder().join(name);
        // No two places of it are alike.
        let words = (0..bytes / 4).flat_map(|n| (n ^ bytes).to_be_bytes());
        fs::write(&path, words.collect::<Vec<u8>>()).unwrap();
        path.display().to_string()
    };
    let put = |path: &str| fleet(&url, &["capture", "put", path]);
    let before = state(&js, names::CAPTURES_STREAM).await;
    let large = file("large", 4_000_000);
    for _ in 0..2 {
        let (text, code) = put(&large);
        assert!(code == 3 && text.contains("do not fit"), "{code} {text}");
        assert_eq!(state(&js, names::CAPTURES_STREAM).await, before);
    }
    // An upload that was killed after its first chunk, and one of another file that goes on.
    let small = file("small", 500_000);
    let head = fs::read(&small).unwrap()[..100_000].to_vec();
    for (nuid, bytes) in [("killed", head), ("other", vec![7; 100_000])] {
        let subject = format!("$O.{}.C.{nuid}", names::CAPTURES);
        js.publish(subject, bytes.into())
            .await
            .unwrap()
            .await
            .unwrap();
    }
    let (text, code) = put(&small);
    assert_eq!(code, 0, "{text}");
    let (_, bytes, _) = state(&js, names::CAPTURES_STREAM).await;
    assert!((600_000..615_000).contains(&bytes), "{bytes}");
}

#[tokio::test]
async fn a_lookup_is_for_a_hob_that_an_edge_has() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let path = server.folder().join("l.bin");
    fs::write(&path, ihd_shared::lookup::prior::prior().to_bytes()).unwrap();
    let push = ["lookup", "push", "bensh", &path.display().to_string()];
    let (text, code) = fleet(&url, &push);
    assert!(code != 0 && text.contains("no edge has a hob"), "{text}");
}
