//! A worker with false answers, a real edge and a real server: no false answer is accepted, learning continues, and edge and operator report
//! it (the table in docs/fleet.md).

use async_nats::jetstream::{self, consumer::PullConsumer};
use futures_util::StreamExt;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_fleet::names;
use ihd_fleet::wire::{AnswerMessage, WindowMessage};
use ihd_store::{ResultFilter, StoreReader};
use ihd_train::NetworkConfig;

use super::server::Server;
use super::site::{PATIENCE, Site, fleet, init, until};

/// Makes the published bytes from an honest answer.
type Lie = fn(AnswerMessage) -> Vec<u8>;

fn stated(mut message: AnswerMessage, change: impl Fn(&mut StatedLoad)) -> Vec<u8> {
    change(message.answer.load.as_mut().expect("an honest answer"));
    message.to_bytes().expect("packed")
}

const LIES: [(&str, Lie); 8] = [
    ("the truth", |m| m.to_bytes().expect("packed")),
    ("R 15 % high", |m| {
        stated(m, |s| s.r_ohm.iter_mut().for_each(|r| *r *= 1.15))
    }),
    ("R twice", |m| {
        stated(m, |s| s.r_ohm.iter_mut().for_each(|r| *r *= 2.0))
    }),
    ("R and L exchanged", |m| {
        stated(m, |s| std::mem::swap(&mut s.r_ohm, &mut s.l_h))
    }),
    ("a current that is 200 ns late", |m| {
        stated(m, |s| {
            let late = (std::f64::consts::TAU * 50e3).powi(2) * 200e-9;
            let values = s.r_ohm.iter_mut().zip(&s.l_h);
            values.for_each(|(r, l)| *r += late * l);
        })
    }),
    ("refused, though it is right", |mut m| {
        m.answer.load = Err("nothing to see".to_owned());
        m.to_bytes().expect("packed")
    }),
    ("another hob's", |mut m| {
        m.hob = "elsewhere".to_owned();
        m.to_bytes().expect("packed")
    }),
    ("noise", |_| b"R is fine, believe me".to_vec()),
];

#[test]
fn lies_teach_nothing_stop_nothing_and_are_told() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::new("lab", 1);
    site.fill(LIES.len());
    site.start(&url);
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    let honest = runtime.block_on(lie(&url));
    until("a result for each window", PATIENCE, || {
        site.results() == site.windows
    });
    let results = StoreReader::open(&site.store()).expect("its store");
    let results = results.results(&ResultFilter::default()).expect("results");
    for ((name, _), (seq, r_ohm)) in LIES.iter().zip(honest) {
        let result = results.iter().find(|r| r.seq == seq).expect("stored");
        let off_pct = 100.0 * (result.r_ohm / r_ohm - 1.0);
        println!("{name}: R of the store {off_pct:+.3} % off the truth");
        assert!(result.pass && off_pct.abs() < 2.0, "{name}: {result:?}");
        assert!(result.power_w.is_some(), "{name}: {result:?}");
    }
    // After three refuted answers the liar's others are not checked, in whatever order they came.
    until("the edge says what happened", PATIENCE, || {
        let report = site.fleet().unwrap_or_default();
        let of = |outcome: &str| report["answers"][outcome].as_u64().unwrap_or(0);
        let others = of("distrusted") + of("unidentified");
        (of("confirmed"), of("refuted"), others) == (1, 3, 4)
    });
    until("status --check", PATIENCE, || {
        let (text, code) = fleet(&url, &["status", "--check"]);
        code == 7 && text.contains("answers of worker liar were refuted")
    });
    site.stop();
}

/// Answers each window with the next lie, and a window that was never sent; returns number and R of each window.
async fn lie(url: &str) -> Vec<(u32, f64)> {
    let client = async_nats::connect(url).await.expect("the server");
    let context = jetstream::new(client);
    let consumer = context.get_consumer_from_stream(names::WORKERS, names::WINDOWS);
    let consumer: PullConsumer = consumer.await.expect("the workers' consumer");
    let mut windows = consumer.messages().await.expect("windows");
    let mut honest = Vec::new();
    for (_, lie) in LIES {
        let message = windows.next().await.expect("a window").expect("whole");
        let window = WindowMessage::from_bytes(&message.payload).expect("it is read");
        let network = NetworkConfig {
            deterministic: true,
            ..NetworkConfig::default()
        };
        let by = if honest.is_empty() { "honest" } else { "liar" };
        let answer = WorkerAnswer::compute(by.to_owned(), &window.window, window.skew_s, network);
        honest.push((window.window.seq, mean_r_ohm(&answer)));
        let answer = AnswerMessage {
            hob: window.hob.clone(),
            boot: window.boot,
            seq: window.window.seq,
            window_at_ms: window.at_ms,
            at_ms: window.at_ms,
            answer,
        };
        let publish = async |seq, bytes: Vec<u8>| {
            let subject = names::result(&window.hob, window.boot, seq);
            let sent = context.publish(subject, bytes.into()).await;
            sent.expect("sent").await.expect("acknowledged");
        };
        let mut unasked = answer.clone();
        unasked.seq = 1_000_000 + answer.seq;
        publish(unasked.seq, unasked.to_bytes().expect("packed")).await;
        publish(answer.seq, lie(answer)).await;
        message.double_ack().await.expect("acknowledged");
    }
    honest
}

/// Returns the mean of R weighted with the squared current, which follows the bus to a percent of R: sin² of the mains' phase.
fn mean_r_ohm(answer: &WorkerAnswer) -> f64 {
    let stated = answer.load.as_ref().expect("an honest answer");
    let weight = |t_s: &f64| (std::f64::consts::PI * t_s / 10e-3).sin().powi(2);
    let weights: f64 = stated.t_s.iter().map(weight).sum();
    let weighted = stated.t_s.iter().zip(&stated.r_ohm);
    weighted.map(|(t, r)| weight(t) * r).sum::<f64>() / weights
}
