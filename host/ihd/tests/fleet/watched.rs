//! Silent edges and hobs in the fleet's status, and a daemon whose files of the fleet cannot be used.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::SystemTime;

use async_nats::jetstream::Context;
use ihd_fakes::free_address;
use ihd_fleet::{jetstream, names};
use ihd_model::FleetDevice;
use serde_json::json;

use super::server::{self, Server};
use super::site::{PATIENCE, Site, fleet, ihd_fleet, init, status, until};

async fn connect(url: &str) -> Context {
    let options = async_nats::ConnectOptions::new().request_timeout(Some(PATIENCE));
    let client = options.connect(url).await.expect("the server");
    let mut context = async_nats::jetstream::new(client);
    context.set_timeout(PATIENCE);
    context
}

async fn put(context: &Context, bucket: &str, key: &str, value: &serde_json::Value) {
    let value = value.to_string().into();
    let sent = context.publish(names::key(bucket, key), value).await;
    sent.expect("sent").await.expect("acknowledged");
}

#[test]
fn an_edge_that_is_gone_is_missed_and_no_card_dates_itself() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    assert_eq!(fleet(&url, &["status", "--check"]).1, 0);
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let tomorrow_ms = now.expect("after 1970").as_millis() as i64 + 86_400_000;
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    runtime.block_on(async {
        let context = connect(&url).await;
        // As an edge leaves them that was killed: its name, and of its hob a card whose clock is a day ahead.
        let claim = json!({ "identity": "a", "host": "cellar", "store": "/s", "at_ms": 0 });
        put(&context, names::CLAIMS, "lab", &claim).await;
        let device = FleetDevice {
            name: "bench".into(),
            edge: "lab".into(),
            last_seen_ms: tomorrow_ms,
            ..FleetDevice::default()
        };
        let card = json!({ "board": "", "device": device });
        put(&context, names::HOBS, "bench", &card).await;
    });
    let (text, code) = fleet(&url, &["status", "--check"]);
    assert!(
        code == 7 && text.contains("edge lab was not heard of"),
        "{text}"
    );
    let report = status(&url).expect("it answers");
    assert_eq!(report["silent_edges"], json!(["lab"]));
    let seen_ms = report["devices"][0]["last_seen_ms"].as_i64();
    assert!(seen_ms <= report["at_ms"].as_i64(), "{report}");
    // Gone for good: its hobs go with it.
    assert_eq!(fleet(&url, &["init", "--free", "lab"]).1, 0);
    let (text, code) = fleet(&url, &["status", "--check"]);
    assert_eq!(code, 0, "{text}");
    assert_eq!(status(&url).expect("it answers")["devices"], json!([]));
}

/// Reading key after key would follow the writer for ever.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_that_are_renewed_faster_than_read_are_read_and_none_is_missed() {
    let server = Server::start("");
    init(&server.url(), &[]);
    let context = connect(&server.url()).await;
    let keys: Vec<String> = (0..40).map(|k| format!("hob-{k}")).collect();
    for key in &keys {
        put(&context, names::HOBS, key, &json!({})).await;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let (writer, stopped, renewed) = (connect(&server.url()).await, stop.clone(), keys.clone());
    let writing = tokio::spawn(async move {
        while !stopped.load(Relaxed) {
            // All are sent at once, and their acknowledgements awaited together: the server never has more than a round to do.
            let sent = renewed.iter().map(|key| async {
                let sent = writer.publish(names::key(names::HOBS, key), "{}".into());
                sent.await?.await
            });
            futures_util::future::try_join_all(sent)
                .await
                .expect("acknowledgements");
        }
    });
    for _ in 0..5 {
        let read = jetstream::entries(&context, names::HOBS);
        let read = tokio::time::timeout(PATIENCE, read).await;
        let read = read.expect("an end").expect("entries");
        let read: BTreeSet<String> = read.into_keys().collect();
        assert_eq!(read, keys.iter().cloned().collect());
    }
    stop.store(true, Relaxed);
    writing.await.expect("the writer");
}

#[test]
fn a_file_of_the_fleet_that_cannot_be_used_stops_no_hob() {
    let mut site = Site::new("lab", 1);
    std::fs::write(site.path().join("key.nk"), "open").expect("a file");
    let open = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    std::fs::set_permissions(site.path().join("key.nk"), open).expect("a mode");
    site.fleet_lines = "nkey_file = \"key.nk\"\n".to_owned();
    site.start("nats://127.0.0.1:9");
    until("the page says why", PATIENCE, || {
        site.assert_runs();
        let report = site.fleet().unwrap_or_default();
        let alarm = report["alarms"][0].as_str().unwrap_or_default();
        alarm.contains("chmod 600") && report["connected"] == false
    });
    site.stop();
}

/// Each certificate is valid for the server and refused by the client.
#[test]
fn up_ends_with_the_reason_where_its_certificate_is_refused() {
    for (name, until_year, reason) in [
        ("127.0.0.1", 2001, "xpired"),
        ("lab.example", 2200, "not valid for name"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let key = rcgen::KeyPair::generate().expect("a key");
        let mut params = rcgen::CertificateParams::new(vec![name.to_owned()]).expect("a name");
        params.not_after = rcgen::date_time_ymd(until_year, 1, 1);
        let certificate = params.self_signed(&key).expect("a certificate").pem();
        std::fs::write(folder.path().join("certificate.pem"), certificate).expect("a file");
        std::fs::write(folder.path().join("key.pem"), key.serialize_pem()).expect("a file");
        let listen = free_address().to_string();
        let out = ihd_fleet(folder.path())
            .args(["init", "up", "--edge", "lab-1=bench", "--tls", "."])
            .args(["--listen", &listen])
            .env(server::PROGRAM, server::program())
            .output()
            .expect("ihd-fleet runs");
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(!out.status.success() && text.contains(reason), "{text}");
    }
}
