//! Rights of each key on the real server with the configuration of a lab. Every refusal stands beside the same call with a
//! key that has the right: a test of the refusal alone would also pass if nothing works.

use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use async_nats::connection::State;
use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull, push};
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::{self, Context, kv, stream};
use async_nats::{Client, ConnectErrorKind, ConnectOptions, HeaderMap, StatusCode};
use futures_util::StreamExt;
use ihd_fleet::names::{self, edge_consumer};
use ihd_fleet::server_config::UserKey;

use crate::lab::Lab;

const REASON_TO_WAIT: Duration = Duration::from_secs(300);

/// Time within which any message would have come.
const QUIET: Duration = Duration::from_millis(500);

/// Request to a consumer for present messages only.
const NOW: &str = r#"{"batch":1,"no_wait":true}"#;

/// Publishes into a stream; returns the message's number, `None` if no stream accepts it.
async fn publish(js: &Context, subject: String, body: &'static str) -> Option<u64> {
    let sent = js.publish(subject.clone(), body.into()).await.unwrap();
    match sent.await {
        Ok(ack) => Some(ack.sequence),
        Err(why) => {
            // At once, and not after a time-out.
            assert_eq!(why.kind(), PublishErrorKind::StreamNotFound, "{subject}");
            None
        }
    }
}

/// Returns the number of a stream's messages, read by its operator.
async fn messages(operator: &Context, stream: &str) -> u64 {
    let mut stream = operator.get_stream(stream).await.unwrap();
    stream.info().await.unwrap().state.messages
}

/// Returns a key's value, read by its operator.
async fn value(operator: &Context, bucket: &str, key: &str) -> Option<String> {
    let bucket = operator.get_key_value(bucket).await.unwrap();
    let value = bucket.get(key).await.unwrap();
    value.map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
}

/// Puts as `kv::Store::put` does, without reading the bucket first.
async fn put(js: &Context, bucket: &str, key: &str, body: &'static str) -> Option<u64> {
    publish(js, format!("$KV.{bucket}.{key}"), body).await
}

/// Returns the content of the next message of a subscription.
async fn hears(subscription: &mut async_nats::Subscriber) -> Option<String> {
    let message = tokio::time::timeout(QUIET, subscription.next()).await;
    let message = message.ok().flatten()?;
    Some(String::from_utf8_lossy(&message.payload).into_owned())
}

/// Returns `true` if a request is answered, and not with "no responders".
async fn answered(client: &Client, subject: String, body: &'static str) -> bool {
    // Not `request`: it knows an answer by its subject, and that of a pulled message is the stream's.
    let inbox = client.new_inbox();
    let mut answers = client.subscribe(inbox.clone()).await.unwrap();
    ask(client, subject, &inbox, body).await;
    let answer = tokio::time::timeout(REASON_TO_WAIT, answers.next()).await;
    let status = answer.expect("an answer, if only that nobody is there");
    status.unwrap().status != Some(StatusCode::NO_RESPONDERS)
}

/// Returns the subject by which a worker requests windows.
fn next_window() -> String {
    format!(
        "$JS.API.CONSUMER.MSG.NEXT.{}.{}",
        names::WINDOWS,
        names::WORKERS
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_edge_does_its_work_and_no_other_hobs() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    let (first, second) = (
        lab.jetstream("lab-edge-lab-1").await,
        lab.jetstream("lab-edge-lab-2").await,
    );
    // Each subject: its own edge may, the other one may not.
    for (stream, subject) in [
        (names::WINDOWS, names::window("hob-a")),
        (names::EVENTS, names::event("hob-b")),
        (names::RESULTS, names::result("hob-a", 1, 7)),
    ] {
        assert_eq!(publish(&second, subject.clone(), "no").await, None);
        assert_eq!(messages(&operator, stream).await, 0, "{subject}");
        assert_eq!(publish(&first, subject.clone(), "yes").await, Some(1));
        assert_eq!(messages(&operator, stream).await, 1, "{subject}");
    }
    for (bucket, key) in [
        (names::LOOKUPS, "hob-a"),
        (names::HOBS, "hob-a"),
        (names::POTS, "hob-a"),
        (names::EDGES, "lab-1"),
    ] {
        assert_eq!(put(&second, bucket, key, "no").await, None, "{bucket}");
        assert_eq!(value(&operator, bucket, key).await, None, "{bucket}");
        assert_eq!(put(&first, bucket, key, "yes").await, Some(1), "{bucket}");
        assert_eq!(value(&operator, bucket, key).await.unwrap(), "yes");
    }
    for (bucket, key) in [(names::SETTINGS, "x"), (names::WORKER_CARDS, "hob-a")] {
        assert_eq!(put(&first, bucket, key, "no").await, None, "{bucket}");
        assert!(put(&operator, bucket, key, "yes").await.is_some());
    }
    // No stream stores a state; subscribers receive it.
    let mut listens = operator
        .client()
        .subscribe(names::state("*"))
        .await
        .unwrap();
    operator.client().flush().await.unwrap();
    let second = second.client();
    second
        .publish(names::state("hob-a"), "no".into())
        .await
        .unwrap();
    assert_eq!(hears(&mut listens).await, None);
    second
        .publish(names::state("hob-c"), "yes".into())
        .await
        .unwrap();
    assert_eq!(hears(&mut listens).await.unwrap(), "yes");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_edge_gets_the_lookups_and_results_of_its_hobs_alone() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    let edge = lab.jetstream("lab-edge-lab-1").await;
    let worker = lab.jetstream("lab-worker-worker-1").await;
    for (hob, lookup) in [("hob-a", "of hob-a"), ("hob-c", "of hob-c")] {
        put(&operator, names::LOOKUPS, hob, lookup).await.unwrap();
        let subject = names::result(hob, 1, 1);
        assert!(publish(&worker, subject, "result").await.is_some());
    }
    let lookups = edge.get_key_value(names::LOOKUPS).await.unwrap();
    assert_eq!(lookups.get("hob-a").await.unwrap().unwrap(), "of hob-a");
    lookups.get("hob-c").await.unwrap_err();
    let by_content = edge.get_stream_no_info("KV_ihd_lookups").await.unwrap();
    by_content.direct_get(2).await.unwrap_err();
    let of_operator = operator.get_stream_no_info("KV_ihd_lookups").await.unwrap();
    assert_eq!(of_operator.direct_get(2).await.unwrap().payload, "of hob-c");
    // Whatever else stands in a request for its own key: another's value is never in the answer.
    let own = "$JS.API.DIRECT.GET.KV_ihd_lookups.$KV.ihd_lookups.hob-a";
    for body in [
        r#"{"seq":2}"#,
        r#"{"last_by_subj":"$KV.ihd_lookups.hob-c"}"#,
        r#"{"next_by_subj":"$KV.ihd_lookups.hob-c"}"#,
        r#"{"multi_last":["$KV.ihd_lookups.>"]}"#,
        r#"{"seq":1,"batch":9}"#,
    ] {
        for value in all_answers(&edge.client(), own, body).await {
            assert_ne!(value, "of hob-c", "{body}");
        }
    }
    assert_eq!(all_answers(&edge.client(), own, "").await, ["of hob-a"]);
    // Put by compare-and-set, and received at once.
    let mut changes = edge.client().subscribe("$KV.ihd_lookups.*").await.unwrap();
    edge.client().flush().await.unwrap();
    put(&operator, names::LOOKUPS, "hob-c", "2").await.unwrap();
    assert_eq!(hears(&mut changes).await, None);
    put(&operator, names::LOOKUPS, "hob-b", "2").await.unwrap();
    assert_eq!(hears(&mut changes).await.unwrap(), "2");
    lookups.update("hob-a", "3".into(), 3).await.unwrap_err();
    lookups.update("hob-a", "3".into(), 1).await.unwrap();
    assert_eq!(lookups.get("hob-a").await.unwrap().unwrap(), "3");

    let own = edge_consumer("lab-1");
    let results: PullConsumer = edge
        .get_consumer_from_stream(&own, names::RESULTS)
        .await
        .unwrap();
    let mut batch = results
        .stream()
        .expires(Duration::from_secs(2))
        .messages()
        .await
        .unwrap();
    let next = tokio::time::timeout(REASON_TO_WAIT, batch.next()).await;
    let next = next.unwrap().unwrap().unwrap();
    assert_eq!(next.subject.as_str(), names::result("hob-a", 1, 1));
    next.double_ack().await.unwrap();
    assert!(tokio::time::timeout(QUIET, batch.next()).await.is_err());
    // Acknowledged is acknowledged: the operator's view of it.
    let mut seen: PullConsumer = operator
        .get_consumer_from_stream(&own, names::RESULTS)
        .await
        .unwrap();
    let info = seen.info().await.unwrap();
    assert_eq!((info.num_ack_pending, info.num_pending), (0, 0));
    // Another's consumer is not there for it.
    let other = edge_consumer("lab-2");
    let denied = edge.get_consumer_from_stream::<pull::Config, _, _>(&other, names::RESULTS);
    assert!(denied.await.is_err());
    let of_other = format!("$JS.API.CONSUMER.MSG.NEXT.{}.{other}", names::RESULTS);
    assert!(!answered(&edge.client(), of_other.clone(), NOW).await);
    let second = lab.client("lab-edge-lab-2").await;
    assert!(answered(&second, of_other, NOW).await);
}

/// Returns the contents of all answers to a request.
async fn all_answers(client: &Client, subject: &str, body: &'static str) -> Vec<String> {
    let inbox = client.new_inbox();
    let mut answers = client.subscribe(inbox.clone()).await.unwrap();
    ask(client, subject.to_owned(), &inbox, body).await;
    let mut contents = Vec::new();
    while let Some(content) = hears(&mut answers).await {
        contents.push(content);
    }
    contents
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_pot_is_readable_and_the_fleet_only_where_it_was_allowed() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    for key in ["hob-a", "hob-c"] {
        put(&operator, names::POTS, key, "pots").await.unwrap();
        put(&operator, names::HOBS, key, "card").await.unwrap();
    }
    let (sees, other) = (
        lab.jetstream("lab-edge-lab-1").await,
        lab.jetstream("lab-edge-lab-2").await,
    );
    let worker = lab.jetstream("lab-worker-worker-1").await;
    for js in [&sees, &other, &worker] {
        assert_eq!(keys(js, names::POTS).await, ["hob-a", "hob-c"]);
    }
    assert_eq!(keys(&sees, names::HOBS).await, ["hob-a", "hob-c"]);
    assert!(keys(&other, names::HOBS).await.is_empty());
    for stream in [names::WINDOWS, names::RESULTS, names::EVENTS, names::DEAD] {
        sees.get_stream(stream).await.unwrap();
        other.get_stream(stream).await.unwrap_err();
    }
    let workers = |js: &Context| {
        let js = js.clone();
        async move {
            js.get_consumer_from_stream::<pull::Config, _, _>(names::WORKERS, names::WINDOWS)
                .await
                .is_ok()
        }
    };
    assert!(workers(&sees).await && !workers(&other).await);
    put(&worker, names::WORKER_CARDS, "worker-1", "here").await;
    assert_eq!(keys(&sees, names::WORKER_CARDS).await, ["worker-1"]);
    assert!(keys(&other, names::WORKER_CARDS).await.is_empty());
}

/// Returns the keys of a bucket, read one after the other.
async fn keys(js: &Context, bucket: &str) -> Vec<String> {
    let stream = js.get_stream_no_info(format!("KV_{bucket}")).await.unwrap();
    let (mut found, mut from) = (Vec::new(), 1);
    let all = format!("$KV.{bucket}.>");
    while let Ok(entry) = stream.direct_get_next_for_subject(&all, Some(from)).await {
        from = entry.sequence + 1;
        let key = entry.subject.as_str().rsplit('.').next().unwrap();
        found.push(key.to_owned());
    }
    found
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_but_the_operator_changes_streams_or_makes_consumers() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    publish(&operator, names::event("hob-a"), "kept")
        .await
        .unwrap();
    for key in ["lab-edge-lab-1", "lab-worker-worker-1"] {
        let js = lab.jetstream(key).await;
        let stream = js.get_stream_no_info(names::EVENTS).await.unwrap();
        stream.purge().await.unwrap_err();
        stream.delete_message(1).await.unwrap_err();
        stream.get_raw_message(1).await.unwrap_err();
        assert!(js.delete_stream(names::EVENTS).await.is_err());
        let own = js.create_stream(stream::Config {
            name: "MINE".to_owned(),
            ..Default::default()
        });
        own.await.unwrap_err();
        let listens = pull::Config {
            durable_name: Some("listens".to_owned()),
            ..Default::default()
        };
        stream.create_consumer(listens).await.unwrap_err();
        // A push consumer delivers to any subject that its maker names.
        let delivers = push::Config {
            deliver_subject: "$KV.ihd_lookups.hob-c".to_owned(),
            ack_policy: AckPolicy::None,
            ..Default::default()
        };
        stream.create_consumer(delivers).await.unwrap_err();
        assert_eq!(messages(&operator, names::EVENTS).await, 1, "{key}");
    }
    // All of it is possible: to the operator.
    let stream = operator.get_stream(names::EVENTS).await.unwrap();
    assert_eq!(stream.get_raw_message(1).await.unwrap().payload, "kept");
    let listens = pull::Config {
        durable_name: Some("listens".to_owned()),
        ..Default::default()
    };
    stream.create_consumer(listens).await.unwrap();
    stream.purge().await.unwrap();
    assert_eq!(messages(&operator, names::EVENTS).await, 0);
    assert!(operator.delete_stream(names::EVENTS).await.unwrap().success);
}

/// The server looks at the subject of a request, not at where the answer is to go, and answers with rights of its own.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_answer_cannot_be_sent_where_its_asker_may_not_write() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    put(&operator, names::LOOKUPS, "hob-c", "good")
        .await
        .unwrap();
    publish(&operator, names::event("hob-c"), "kept")
        .await
        .unwrap();
    let own = "$JS.API.DIRECT.GET.KV_ihd_lookups.$KV.ihd_lookups.hob-a";
    let next = format!(
        "$JS.API.CONSUMER.MSG.NEXT.{}.{}",
        names::RESULTS,
        edge_consumer("lab-1")
    );
    let (lookup, purge) = (
        "$KV.ihd_lookups.hob-c",
        format!("$JS.API.STREAM.PURGE.{}", names::EVENTS),
    );
    let edge = lab.jetstream("lab-edge-lab-1").await;
    for (answer, body) in [(lookup, "evil"), (purge.as_str(), "")] {
        put(&edge, names::LOOKUPS, "hob-a", body).await.unwrap();
        let seq = if body.is_empty() { 2 } else { 1 };
        let result = names::result("hob-a", 1, seq);
        publish(&edge, result, body).await.unwrap();
        for (subject, request) in [
            (own.to_owned(), ""),
            (next.clone(), "1"),
            (names::window("hob-a"), "w"),
            (names::event("hob-a"), "e"),
            ("$KV.ihd_hobs.hob-a".to_owned(), "h"),
        ] {
            ask(&edge.client(), subject, answer, request).await;
        }
        tokio::time::sleep(QUIET).await;
        let lookup = value(&operator, names::LOOKUPS, "hob-c").await;
        assert_eq!(lookup.unwrap(), "good", "{answer}");
        // That of hob-c, and one of ours for each round so far.
        let events = messages(&operator, names::EVENTS).await;
        assert_eq!(events, 1 + seq, "{answer}");
    }
    let worker = lab.client("lab-worker-worker-1").await;
    let windows = next_window();
    ask(&worker, windows, lookup, "1").await;
    ask(&worker, names::result("hob-c", 1, 1), lookup, "r").await;
    tokio::time::sleep(QUIET).await;
    let found = value(&operator, names::LOOKUPS, "hob-c").await;
    assert_eq!(found.unwrap(), "good");
    // The way itself is open: within the site's account the same two requests write and purge.
    put(&operator, names::LOOKUPS, "hob-a", "evil").await;
    ask(&operator.client(), own.to_owned(), lookup, "").await;
    tokio::time::sleep(QUIET).await;
    let found = value(&operator, names::LOOKUPS, "hob-c").await;
    assert_eq!(found.unwrap(), "evil");
    put(&operator, names::LOOKUPS, "hob-a", "").await;
    ask(&operator.client(), own.to_owned(), &purge, "").await;
    tokio::time::sleep(QUIET).await;
    assert_eq!(messages(&operator, names::EVENTS).await, 0);
}

/// Sends a request whose answer goes to `answer`.
async fn ask(client: &Client, subject: String, answer: &str, body: &'static str) {
    let sent = client.publish_with_reply(subject, answer.to_owned(), body.into());
    sent.await.unwrap();
    client.flush().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_put_cannot_empty_the_bucket() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    put(&operator, names::LOOKUPS, "hob-c", "kept")
        .await
        .unwrap();
    let roll_up = || {
        let mut headers = HeaderMap::new();
        headers.insert("Nats-Rollup", "all");
        headers
    };
    let edge = lab.jetstream("lab-edge-lab-1").await;
    let subject = "$KV.ihd_lookups.hob-a";
    let sent = edge.publish_with_headers(subject, roll_up(), "x".into());
    sent.await.unwrap().await.unwrap_err();
    let found = value(&operator, names::LOOKUPS, "hob-c").await;
    assert_eq!(found.unwrap(), "kept");
    // A bucket as the client makes it would be empty now.
    let usual = kv::Config {
        bucket: "usual".to_owned(),
        ..Default::default()
    };
    operator.create_key_value(usual).await.unwrap();
    put(&operator, "usual", "hob-c", "kept").await.unwrap();
    let sent = operator.publish_with_headers("$KV.usual.hob-a", roll_up(), "x".into());
    sent.await.unwrap().await.unwrap();
    assert_eq!(value(&operator, "usual", "hob-c").await, None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_pulls_windows_and_publishes_results_and_nothing_else() {
    let lab = Lab::start().await;
    let operator = lab.jetstream("lab-operator").await;
    let edge = lab.jetstream("lab-edge-lab-2").await;
    let worker = lab.jetstream("lab-worker-worker-2").await;
    publish(&edge, names::window("hob-c"), "window")
        .await
        .unwrap();
    let windows: PullConsumer = worker
        .get_consumer_from_stream(names::WORKERS, names::WINDOWS)
        .await
        .unwrap();
    let mut pulled = windows.messages().await.unwrap();
    let window = tokio::time::timeout(REASON_TO_WAIT, pulled.next()).await;
    let window = window.unwrap().unwrap().unwrap();
    assert_eq!(window.payload, "window");
    window.ack_with(jetstream::AckKind::Progress).await.unwrap();
    let result = names::result("hob-c", 1, 1);
    assert!(publish(&worker, result, "result").await.is_some());
    window.double_ack().await.unwrap();
    assert_eq!(messages(&operator, names::WINDOWS).await, 0);
    let dead = names::dead_letter("hob-c", 1, 2);
    assert!(publish(&worker, dead, "dead").await.is_some());
    let card = put(&worker, names::WORKER_CARDS, "worker-2", "here").await;
    assert!(card.is_some());

    for (subject, may) in [
        ("$KV.ihd_lookups.hob-c", &edge),
        ("$KV.ihd_hobs.hob-c", &edge),
        ("$KV.ihd_pots.hob-c", &edge),
        ("$KV.ihd_edges.lab-2", &edge),
        ("$KV.ihd_workers.worker-1", &operator),
        ("$KV.ihd_settings.limits", &operator),
        ("ihd.v2.hob-c.window", &edge),
        ("ihd.v1.hob-c.event", &edge),
    ] {
        let subject = subject.to_owned();
        assert_eq!(publish(&worker, subject.clone(), "no").await, None);
        assert!(publish(may, subject, "yes").await.is_some());
    }
    let lookup = "$JS.API.DIRECT.GET.KV_ihd_lookups.$KV.ihd_lookups.hob-c";
    assert!(!answered(&worker.client(), lookup.to_owned(), "").await);
    assert!(answered(&edge.client(), lookup.to_owned(), "").await);
    // An edge pulls no windows.
    let next = next_window();
    assert!(!answered(&edge.client(), next.clone(), NOW).await);
    assert!(answered(&worker.client(), next.clone(), NOW).await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sites_do_not_see_each_other() {
    let lab = Lab::start().await;
    let (operator, other) = (
        lab.jetstream("lab-operator").await,
        lab.jetstream("field-operator").await,
    );
    let mut all = other.client().subscribe(">").await.unwrap();
    other.client().flush().await.unwrap();
    // The same subject at both.
    let subject = names::window("hob-a");
    let edge = lab.jetstream("lab-edge-lab-1").await;
    assert!(publish(&edge, subject.clone(), "lab's").await.is_some());
    assert_eq!(messages(&operator, names::WINDOWS).await, 1);
    assert_eq!(messages(&other, names::WINDOWS).await, 0);
    let edge = lab.jetstream("field-edge-field-1").await;
    assert!(publish(&edge, subject, "field's").await.is_some());
    assert_eq!(messages(&operator, names::WINDOWS).await, 1);
    assert_eq!(messages(&other, names::WINDOWS).await, 1);
    let mut heard = Vec::new();
    while let Some(content) = hears(&mut all).await {
        heard.push(content);
    }
    assert!(heard.contains(&"field's".to_owned()), "{heard:?}");
    assert!(!heard.contains(&"lab's".to_owned()), "{heard:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_is_not_known_is_told_so_and_a_strange_server_is_refused() {
    let lab = Lab::start().await;
    let key = "lab-edge-lab-1";
    assert!(lab.options(key).connect(lab.url()).await.is_ok());
    // An unknown key.
    let stranger = UserKey::make().unwrap();
    let wrong = ConnectOptions::with_nkey(stranger.seed().to_owned())
        .add_root_certificates(lab.certificate())
        .require_tls(true);
    let refused = wrong.connect(lab.url()).await.unwrap_err();
    assert_eq!(refused.kind(), ConnectErrorKind::AuthorizationViolation);
    assert!(refused.to_string().contains("authorization"), "{refused}");
    // None at all.
    let nobody = ConnectOptions::new()
        .add_root_certificates(lab.certificate())
        .require_tls(true);
    let refused = nobody.connect(lab.url()).await.unwrap_err();
    assert_eq!(refused.kind(), ConnectErrorKind::AuthorizationViolation);
    // Without the certificate, the client does not know who answers.
    let blind = ConnectOptions::with_nkey(lab.key(key).seed().to_owned()).require_tls(true);
    let refused = blind.connect(lab.url()).await.unwrap_err();
    let why = format!("{refused} {:?}", std::error::Error::source(&refused));
    assert!(why.contains("UnknownIssuer"), "{why}");
    // And with another's, neither.
    let other = Lab::with_sites(Vec::new());
    let fooled = ConnectOptions::with_nkey(lab.key(key).seed().to_owned())
        .add_root_certificates(other.certificate())
        .require_tls(true);
    assert!(fooled.connect(lab.url()).await.is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revoked_key_is_out_at_once_and_the_others_stay() {
    let mut lab = Lab::start().await;
    let (lost, kept) = (
        lab.jetstream("lab-edge-lab-1").await,
        lab.jetstream("lab-edge-lab-2").await,
    );
    let operator = lab.jetstream("lab-operator").await;
    let (of_lost, of_kept) = (names::window("hob-a"), names::window("hob-c"));
    assert!(publish(&lost, of_lost.clone(), "1").await.is_some());
    assert!(publish(&kept, of_kept.clone(), "1").await.is_some());
    let connected = kept.client().statistics().connects.load(Relaxed);

    lab.forget_edge("lab-1");
    lab.server.reload().unwrap();
    let again = lab.options("lab-edge-lab-1").connect(lab.url()).await;
    let refused = again.unwrap_err();
    assert_eq!(refused.kind(), ConnectErrorKind::AuthorizationViolation);
    let deadline = tokio::time::Instant::now() + REASON_TO_WAIT;
    while lost.client().connection_state() == State::Connected {
        assert!(tokio::time::Instant::now() < deadline, "it is still in");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // The site's data stay, and other clients stay connected.
    assert!(publish(&kept, of_kept, "2").await.is_some());
    assert_eq!(messages(&operator, names::WINDOWS).await, 3);
    let now = kept.client().statistics().connects.load(Relaxed);
    assert_eq!(now, connected);
}
