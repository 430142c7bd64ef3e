//! An hour of 200 edges on one server with four workers, compressed in time: the table of docs/fleet.md (`--profile full hour`).
//!
//! Real: the server, the workers' processes with their network, the messages with their numbers, the edges' connections, consumers, acknowledgements,
//! states, cards and checks of their name. Simplified: an edge is a task of this process without daemon, store and learner, whose share
//! `study::what_a_window_costs_at_length` measures.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use async_nats::jetstream;
use async_nats::jetstream::message::PublishMessage;
use futures_util::StreamExt;
use ihd_fleet::jetstream::init_edge;
use ihd_fleet::wire::{AnswerMessage, WindowMessage};
use ihd_fleet::{MessageIds, names};
use serde_json::Value;

use super::process::processor_s;
use super::server::Server;
use super::site::{Worker, init, tape, until};

/// Time-out of the whole test.
const PATIENCE: Duration = Duration::from_secs(7_200);

/// Edges, each with one hob.
const EDGES: u32 = 200;

/// Workers, a thread each.
const WORKERS: usize = 4;

/// Seconds between two windows of a hob.
const WINDOW_EVERY_S: f64 = 60.0;

/// Seconds between two states of a hob, two checks of the edge's name, two cards.
const STATE_EVERY_S: f64 = 1.0;
const NAME_EVERY_S: f64 = 5.0;
const CARD_EVERY_S: f64 = 10.0;

/// Reads a number of the environment.
fn number(name: &str, otherwise: f64) -> f64 {
    let value = std::env::var(name).ok();
    value.map_or(otherwise, |value| value.parse().expect("a number"))
}

/// Counts of all edges together.
#[derive(Default)]
struct Counts {
    answered: AtomicU64,
    found: AtomicU64,
    window_bytes: AtomicU64,
    answer_bytes: AtomicU64,
    /// Seconds from the window to its answer.
    waited_s: Mutex<Vec<f64>>,
}

/// An edge: sends its windows at their times, receives their answers, publishes states and cards.
struct Edge {
    hob: String,
    k: u32,
    /// Factor of time compression.
    faster: f64,
    windows: u32,
    counts: Arc<Counts>,
    began: Instant,
}

impl Edge {
    async fn run(self, url: String) {
        let client = async_nats::connect(&url).await.expect("a connection");
        let context = jetstream::new(client.clone());
        let hobs = [self.hob.clone()];
        init_edge(&context, &self.hob, &hobs)
            .await
            .expect("its consumer");
        let sent = Mutex::new(std::collections::BTreeMap::new());
        tokio::join!(
            self.send(&context, &sent),
            self.receive(&context, &sent),
            self.publish_cards(&client, &context),
        );
    }

    fn every(&self, seconds: f64) -> tokio::time::Interval {
        let mut every = tokio::time::interval(Duration::from_secs_f64(seconds / self.faster));
        every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        every
    }

    async fn send(
        &self,
        context: &jetstream::Context,
        sent: &Mutex<std::collections::BTreeMap<u32, Instant>>,
    ) {
        let message_ids = MessageIds::new([self.k as u8; 16]);
        let share = f64::from(self.k) / f64::from(EDGES);
        let tape = &tape().windows;
        for seq in 0..self.windows {
            let at_s = WINDOW_EVERY_S * (f64::from(seq) + share) / self.faster;
            let at = self.began + Duration::from_secs_f64(at_s);
            tokio::time::sleep_until(at.into()).await;
            let mut window = tape[(self.k + seq) as usize % tape.len()].clone();
            window.seq = seq;
            let message = WindowMessage {
                hob: self.hob.clone(),
                boot: 1,
                at_ms: 0,
                skew_s: None,
                not_for: Vec::new(),
                window,
            };
            let bytes = message.to_bytes().expect("packed");
            self.counts
                .window_bytes
                .fetch_add(bytes.len() as u64, Relaxed);
            sent.lock().unwrap().insert(seq, Instant::now());
            let message = PublishMessage::build()
                .payload(bytes.into())
                .message_id(message_ids.window_id(&self.hob, 1, seq));
            let acknowledged = context.send_publish(names::window(&self.hob), message);
            acknowledged
                .await
                .expect("sent")
                .await
                .expect("acknowledged");
        }
    }

    async fn receive(
        &self,
        context: &jetstream::Context,
        sent: &Mutex<std::collections::BTreeMap<u32, Instant>>,
    ) {
        let name = names::edge_consumer(&self.hob);
        let consumer: jetstream::consumer::PullConsumer = context
            .get_consumer_from_stream(&name, names::RESULTS)
            .await
            .expect("its consumer");
        let mut left = self.windows;
        while left > 0 {
            let wait = Duration::from_secs_f64(5.0 / self.faster);
            let fetched = consumer.fetch().max_messages(32).expires(wait).messages();
            let mut fetched = fetched.await.expect("asked");
            while let Some(message) = fetched.next().await {
                let message = message.expect("a result");
                let answer = AnswerMessage::from_bytes(&message.payload).expect("an answer");
                let counts = &self.counts;
                counts
                    .answer_bytes
                    .fetch_add(message.payload.len() as u64, Relaxed);
                counts
                    .found
                    .fetch_add(u64::from(answer.answer.load.is_ok()), Relaxed);
                let since = sent.lock().unwrap().remove(&answer.seq).expect("asked for");
                counts
                    .waited_s
                    .lock()
                    .unwrap()
                    .push(since.elapsed().as_secs_f64());
                message.ack().await.expect("acknowledged");
                counts.answered.fetch_add(1, Relaxed);
                left -= 1;
            }
        }
    }

    /// Publishes states and cards and checks the name while windows are sent.
    async fn publish_cards(&self, client: &async_nats::Client, context: &jetstream::Context) {
        let end_s = WINDOW_EVERY_S * f64::from(self.windows) / self.faster;
        let end = self.began + Duration::from_secs_f64(end_s);
        let card = "x".repeat(300);
        let claims = names::bucket_stream(names::CLAIMS);
        let claims = context.get_stream_no_info(claims).await.expect("claims");
        let key = names::key(names::CLAIMS, &self.hob);
        let (mut state, mut name, mut cards) = (
            self.every(STATE_EVERY_S),
            self.every(NAME_EVERY_S),
            self.every(CARD_EVERY_S),
        );
        while Instant::now() < end {
            tokio::select! {
                _ = state.tick() => {
                    let sent = client.publish(names::state(&self.hob), card.clone().into());
                    sent.await.expect("a state");
                }
                _ = name.tick() => {
                    // There is no claim; the answer takes as long.
                    let _ = claims.direct_get_last_for_subject(key.clone()).await;
                }
                _ = cards.tick() => {
                    for bucket in [names::HOBS, names::EDGES] {
                        let key = names::key(bucket, &self.hob);
                        let sent = context.publish(key, card.clone().into()).await;
                        sent.expect("a card").await.expect("acknowledged");
                    }
                }
            }
        }
    }
}

/// Reads counts of the server from its monitoring port.
fn server_counts(port: u16, address: &str) -> [f64; 4] {
    let mut stream = TcpStream::connect((address, port)).expect("its monitoring");
    let asked = format!("GET /varz HTTP/1.0\r\nHost: {address}\r\n\r\n");
    stream.write_all(asked.as_bytes()).expect("asked");
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("an answer");
    let (_, body) = text.split_once("\r\n\r\n").expect("a body");
    let varz: Value = serde_json::from_str(body).expect("JSON");
    ["in_msgs", "in_bytes", "out_msgs", "out_bytes"].map(|field| varz[field].as_f64().unwrap())
}

/// Returns the memory of a process in megabyte.
fn rss_mb(pid: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{pid}/statm")).unwrap_or_default();
    let pages = text
        .split_whitespace()
        .nth(1)
        .and_then(|n| n.parse::<f64>().ok());
    pages.unwrap_or(f64::NAN) * 4_096e-6
}

fn percentile(values: &mut [f64], percent: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (values.len() as f64 * percent / 100.0).ceil() as usize;
    values
        .get(rank.saturating_sub(1))
        .copied()
        .unwrap_or(f64::NAN)
}

/// `IHD_FLEET_MINUTES` (60) minutes, `IHD_FLEET_FASTER` (3) times as fast.
#[test]
fn an_hour_of_two_hundred_edges_at_length() {
    let faster = number("IHD_FLEET_FASTER", 3.0);
    let windows = number("IHD_FLEET_MINUTES", 60.0) as u32;
    let server =
        Server::configured(|place| format!("{}http: {}\n", place.basics(), place.any_port()));
    let (url, monitoring) = (server.url(), server.monitoring_port());
    let address = server.address().ip().to_string();
    init(&url, &["--threads", &WORKERS.to_string()]);
    let folder = tempfile::tempdir().expect("a folder");
    let workers: Vec<Worker> = (0..WORKERS)
        .map(|k| Worker::start(folder.path(), &url, &format!("w{k}"), &["--threads", "1"]))
        .collect();
    tape();
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    let total = u64::from(EDGES * windows);
    let counts = Arc::new(Counts::default());
    let before = server_counts(monitoring, &address);
    let own = std::process::id();
    let busy = |server: &Server| {
        let of_workers: f64 = workers.iter().map(Worker::processor_s).sum();
        [processor_s(server.pid()), of_workers, processor_s(own)]
    };
    let busy_before = busy(&server);
    // All are connected by then.
    let began = Instant::now() + Duration::from_secs(10);
    for k in 0..EDGES {
        let edge = Edge {
            hob: format!("hob-{k}"),
            k,
            faster,
            windows,
            counts: Arc::clone(&counts),
            began,
        };
        runtime.spawn(edge.run(url.clone()));
    }
    let monitor = runtime
        .block_on(async_nats::connect(&url))
        .expect("the server");
    let monitor = {
        let _within = runtime.enter();
        jetstream::new(monitor)
    };
    let mut depths = Vec::new();
    let mut memory_mb = [0.0f64; 2];
    until("all answers", PATIENCE, || {
        std::thread::sleep(Duration::from_millis(500));
        let state = runtime.block_on(async {
            let mut stream = monitor.get_stream(names::WINDOWS).await.expect("a stream");
            stream.info().await.expect("its state").state.clone()
        });
        depths.push(state.messages as f64);
        let of_workers = workers.iter().map(|w| rss_mb(w.pid())).fold(0.0, f64::max);
        memory_mb = [
            memory_mb[0].max(rss_mb(server.pid())),
            memory_mb[1].max(of_workers),
        ];
        counts.answered.load(Relaxed) == total
    });
    let took = began.elapsed().as_secs_f64();
    let after = server_counts(monitoring, &address);
    let busy_after = busy(&server);
    let each = |k: usize| (after[k] - before[k]) / total as f64;
    let ms = |k: usize| 1e3 * (busy_after[k] - busy_before[k]) / total as f64;
    let mut waited_s = counts.waited_s.lock().unwrap().clone();
    let of = |count: &AtomicU64| count.load(Relaxed) as f64 / total as f64;
    println!(
        "| {EDGES} edges, {windows} min at {faster} times, {WORKERS} workers, {took:.0} s | |\n|---|---|"
    );
    println!(
        "| windows answered | {total}, {:.0} % with R and L |",
        100.0 * of(&counts.found)
    );
    println!(
        "| a window, its answer, bytes | {:.0}, {:.0} |",
        of(&counts.window_bytes),
        of(&counts.answer_bytes)
    );
    println!(
        "| messages into and out of the server, a window | {:.1}, {:.1} |",
        each(0),
        each(2)
    );
    println!(
        "| bytes into and out of the server, a window | {:.0}, {:.0} |",
        each(1),
        each(3)
    );
    println!(
        "| windows in the queue: p50, p99, most | {:.0}, {:.0}, {:.0} |",
        percentile(&mut depths.clone(), 50.0),
        percentile(&mut depths.clone(), 99.0),
        percentile(&mut depths, 100.0)
    );
    println!(
        "| from the window to its answer: p50, p99, s | {:.2}, {:.2} |",
        percentile(&mut waited_s, 50.0),
        percentile(&mut waited_s, 99.0)
    );
    println!(
        "| processor a window: server, workers, edges, ms | {:.2}, {:.1}, {:.2} |",
        ms(0),
        ms(1),
        ms(2)
    );
    println!(
        "| memory: server, a worker, MB | {:.0}, {:.0} |",
        memory_mb[0], memory_mb[1]
    );
}
