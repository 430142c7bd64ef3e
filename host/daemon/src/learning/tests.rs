//! Tests of the queue with a scripted identification, and of learning on windows of the
//! simulated hob.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ihd_link::{Client, DeviceEvent, Window};
use ihd_shared::sampling::Scales;
use ihd_shared::wire::messages::{State, Telemetry};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_train::NetworkConfig;
use ihd_train::learning::{Learning, WindowOutcome};
use tokio::sync::mpsc;

use super::*;

/// Longest wait for an event; it only ends a hang.
const PATIENCE: Duration = Duration::from_secs(300);

fn settings(threads: usize, queue: usize) -> LearnerSettings {
    LearnerSettings {
        threads,
        queue,
        network: NetworkConfig {
            deterministic: true,
            ..NetworkConfig::default()
        },
    }
}

fn window(seq: u32) -> Box<Window> {
    Box::new(Window {
        seq,
        half_cycle: 20 * seq,
        f_sw_hz: 45_000,
        half_cycle_ns: 10_000_000,
        first_pair_ns: 0,
        pairs: Vec::new(),
        first_trajectory_ns: 0,
        trajectory: Vec::new(),
        saturated: 0,
        lookup_version: 0,
        scales: Scales::OF_THIS_BUILD,
    })
}

fn job(device: &str, window: Box<Window>) -> LearnJob {
    LearnJob {
        device: device.to_owned(),
        device_id: 1,
        session: 2,
        boot: 3,
        input: LearnInput::Window(window),
        power_w: Some(1_000.0),
        truth: None,
        stored: None,
    }
}

fn unfit() -> WindowOutcome {
    WindowOutcome::Refused {
        why: "a test".into(),
        identified: None,
        findings: Vec::new(),
    }
}

/// Identification that waits for a gate and counts concurrent calls.
#[derive(Default)]
struct Bench {
    open: AtomicBool,
    running: AtomicUsize,
    most: AtomicUsize,
    seen: Mutex<Vec<u32>>,
}

impl Bench {
    fn observe_fn(self: &Arc<Self>) -> Box<super::shared::ObserveFn> {
        let bench = Arc::clone(self);
        Box::new(move |_: &mut Learning, window: &Window| {
            let running = bench.running.fetch_add(1, Ordering::SeqCst) + 1;
            bench.most.fetch_max(running, Ordering::SeqCst);
            while !bench.open.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(1));
            }
            bench.seen.lock().unwrap().push(window.seq);
            bench.running.fetch_sub(1, Ordering::SeqCst);
            assert!(window.seq != 666, "the number of the beast");
            unfit()
        })
    }
}

fn receive(outcomes: &mut mpsc::Receiver<LearnResult>, n: usize) -> Vec<LearnResult> {
    (0..n)
        .map(|_| outcomes.blocking_recv().expect("an outcome"))
        .collect()
}

/// Waits until a thread has taken the first window.
fn wait_until_busy(bench: &Arc<Bench>) {
    let until = Instant::now() + PATIENCE;
    while bench.running.load(Ordering::SeqCst) == 0 {
        assert!(Instant::now() < until, "no thread took the window");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_device_that_sends_much_neither_starves_the_others_nor_costs_them_windows() {
    let bench = Arc::new(Bench::default());
    let (to, mut outcomes) = mpsc::channel(256);
    let learner = Learner::start_with(settings(1, 16), to, bench.observe_fn()).unwrap();
    assert_eq!(learner.offer(job("fast", window(0))), None);
    wait_until_busy(&bench);
    let mut dropped = Vec::new();
    for seq in 1..=100 {
        dropped.extend(learner.offer(job("fast", window(seq))));
        if seq % 50 == 0 {
            dropped.extend(learner.offer(job("slow", window(1_000 + seq))));
        }
    }
    // Its oldest windows, in order.
    assert!(dropped.iter().all(|d| d.device == "fast"), "{dropped:?}");
    let seqs: Vec<u32> = dropped.iter().map(|d| d.seq).collect();
    assert_eq!(seqs, (1..=86).collect::<Vec<_>>());
    assert_eq!(
        (
            learner.unlearned_count("fast"),
            learner.unlearned_count("slow")
        ),
        (86, 0)
    );
    assert_eq!(learner.figures().waiting, 16);
    bench.open.store(true, Ordering::SeqCst);
    let learned = receive(&mut outcomes, 17);
    let seqs_of = |name: &str| -> Vec<u32> {
        let results = learned.iter().filter(|l| l.device == name);
        results.map(|l| l.result.seq).collect()
    };
    assert_eq!(seqs_of("slow"), [1_050, 1_100]);
    let fast: Vec<u32> = std::iter::once(0).chain(87..=100).collect();
    assert_eq!(seqs_of("fast"), fast);
    // In turn: both windows of `slow` are among the first after the one in progress.
    let last_slow = learned.iter().rposition(|l| l.device == "slow");
    assert!(last_slow <= Some(4), "{last_slow:?}");
    let figures = learner.stop();
    assert_eq!((figures.learned, figures.unlearned), (17, 86));
}

#[test]
fn windows_of_a_device_are_learned_one_at_a_time_and_in_order_on_many_threads() {
    let bench = Arc::new(Bench::default());
    let (to, mut outcomes) = mpsc::channel(8);
    let learner = Learner::start_with(settings(4, 64), to, bench.observe_fn()).unwrap();
    for seq in 0..10 {
        learner.offer(job("a", window(seq)));
    }
    wait_until_busy(&bench);
    bench.open.store(true, Ordering::SeqCst);
    let learned = receive(&mut outcomes, 10);
    assert!(learned.iter().map(|l| l.result.seq).eq(0..10));
    assert_eq!(bench.most.load(Ordering::SeqCst), 1);
    for seq in 0..4 {
        for name in ["a", "b", "c"] {
            learner.offer(job(name, window(seq)));
        }
    }
    let mut by_device: HashMap<String, Vec<u32>> = HashMap::new();
    for l in receive(&mut outcomes, 12) {
        by_device.entry(l.device).or_default().push(l.result.seq);
    }
    assert!(
        by_device.values().all(|seqs| *seqs == [0, 1, 2, 3]),
        "{by_device:?}"
    );
    learner.stop();
}

#[test]
fn a_panic_costs_its_window_alone() {
    let bench = Arc::new(Bench::default());
    bench.open.store(true, Ordering::SeqCst);
    let (to, mut outcomes) = mpsc::channel(8);
    let learner = Learner::start_with(settings(1, 64), to, bench.observe_fn()).unwrap();
    for seq in [665, 666, 667] {
        learner.offer(job("a", window(seq)));
    }
    let learned = receive(&mut outcomes, 3);
    assert!(learned.iter().map(|l| l.result.seq).eq(665..668));
    assert!(
        learned[1].result.why.contains("number of the beast"),
        "{learned:?}"
    );
    assert!(learned[1].result.r_ohm.is_nan() && !learned[1].result.pass);
    assert_eq!(learner.stop().panics, 1);
}

/// Wrong answers end no thread, their windows are identified here, and their worker becomes distrusted.
#[test]
fn wrong_answers_end_no_thread() {
    let bench = Arc::new(Bench::default());
    bench.open.store(true, Ordering::SeqCst);
    let (to, mut outcomes) = mpsc::channel(8);
    let learner = Learner::start_with(settings(1, 64), to, bench.observe_fn()).unwrap();
    let stated = |t_s: &[f64], r_ohm: &[f64]| StatedLoad {
        t_s: t_s.to_vec(),
        r_ohm: r_ohm.to_vec(),
        l_h: vec![20e-6; t_s.len()],
        ..StatedLoad::default()
    };
    let ramp: Vec<f64> = (0..100).map(|k| 1e-4 * f64::from(k)).collect();
    let lies = [
        stated(&ramp, &[3.0; 100]),
        stated(&ramp, &[f64::NAN; 100]),
        stated(&[], &[]),
        stated(&ramp, &[3.0; 100]),
        stated(&[f64::INFINITY; 100], &[3.0; 1]),
    ];
    for (seq, lie) in (0..).zip(lies) {
        let answer = WorkerAnswer {
            by: "liar".to_owned(),
            skew_s: Some(f64::NAN),
            load: Ok(lie),
            busy: Duration::MAX,
        };
        learner.offer(LearnJob {
            input: LearnInput::Answered(window(seq), Box::new(answer)),
            ..job("a", window(0))
        });
    }
    learner.offer(job("a", window(5)));
    let learned = receive(&mut outcomes, 6);
    assert!(learned.iter().map(|l| l.result.seq).eq(0..6));
    let liar = &learner.workers()["liar"];
    assert!(liar.is_distrusted(), "{liar:?}");
    assert_eq!((liar.refuted, liar.distrusted, liar.confirmed), (3, 2, 0));
    assert_eq!(learner.stop().panics, 0);
}

/// A window of an earlier boot has a result, and what was learned stays as it was.
#[test]
fn a_window_of_an_earlier_boot_teaches_nothing() {
    let observe = |learning: &mut Learning, _: &Window| {
        learning.begin_boot(99);
        unfit()
    };
    let (to, mut outcomes) = mpsc::channel(8);
    let learner = Learner::without_threads(settings(1, 8), to, Box::new(observe));
    let mut learn = |job: LearnJob| {
        learner.offer(job);
        assert!(learner.learn_one());
        outcomes.blocking_recv().expect("an outcome").is_late
    };
    learner.add("a", None).unwrap();
    learner.begin_boot("a", 4);
    let before = learner.state_of("a");
    let answer = WorkerAnswer {
        by: "w".to_owned(),
        skew_s: None,
        load: Err("nothing found".to_owned()),
        busy: Duration::ZERO,
    };
    assert!(learn(job("a", window(1))));
    assert!(learn(LearnJob {
        input: LearnInput::Answered(window(2), Box::new(answer)),
        ..job("a", window(0))
    }));
    assert_eq!(
        (learner.state_of("a"), learner.unlearned_count("a")),
        (before.clone(), 2)
    );
    assert!(!learn(LearnJob {
        boot: 4,
        ..job("a", window(3))
    }));
    assert_ne!(learner.state_of("a"), before);
    assert_eq!(learner.unlearned_count("a"), 2);
}

#[test]
fn a_slow_or_missing_receiver_does_not_block_offer() {
    let bench = Arc::new(Bench::default());
    bench.open.store(true, Ordering::SeqCst);
    let (to, mut outcomes) = mpsc::channel(1);
    let learner = Learner::start_with(settings(2, 4), to, bench.observe_fn()).unwrap();
    let mut dropped = 0;
    // Nothing receives outcomes yet: an `offer` that waits would never return.
    for seq in 0..1_000 {
        dropped += usize::from(learner.offer(job("a", window(seq))).is_some());
    }
    assert!((990..=996).contains(&dropped), "{dropped}");
    let left = 1_000 - dropped;
    let first = receive(&mut outcomes, left);
    assert_eq!(first.len() + dropped, 1_000);
    for seq in 0..4 {
        learner.offer(job("b", window(seq)));
    }
    // Nothing receives the remaining outcomes; the learner ends all the same.
    learner.stop();
    drop(outcomes);
}

/// Returns windows of a simulated hob at several powers.
#[expect(clippy::vec_box, reason = "as the link hands them over")]
fn windows(warming: bool, powers_w: &[u16], of_each: usize) -> Vec<Box<Window>> {
    let hob = SharedHob::new(SimHob::new(&HobConfig {
        warming,
        ..HobConfig::default()
    }));
    let mut client = Client::connect(Box::new(hob)).unwrap();
    client.stream(1, 20).unwrap();
    let mut windows = Vec::new();
    let heats = |t: &Telemetry| t.state == State::Heating;
    let mut telemetry: Option<Telemetry> = None;
    for power_w in powers_w {
        client.set_power(*power_w).unwrap();
        let mut count = 0;
        while count < of_each {
            match client.next_event(Duration::from_secs(1)).unwrap() {
                Some(DeviceEvent::Window(w)) if telemetry.as_ref().is_some_and(heats) => {
                    windows.push(w);
                    count += 1;
                }
                Some(DeviceEvent::Telemetry(t)) => telemetry = Some(t),
                Some(_) => {}
                None => panic!("the hob is silent"),
            }
        }
    }
    windows
}

#[test]
fn windows_of_a_hob_become_results_and_lookups_whatever_ends_the_learner_between() {
    let windows = windows(false, &[1_500, 2_000, 1_000], 4);
    let run = |restart_every: usize| {
        let mut saved: Option<Vec<u8>> = None;
        let mut lookups = Vec::new();
        let mut passed = 0;
        for some in windows.chunks(restart_every) {
            let (to, mut outcomes) = mpsc::channel(64);
            let learner = Learner::start(settings(1, 64), to).unwrap();
            learner.add("hob", saved.as_deref()).unwrap();
            for window in some {
                learner.offer(job("hob", window.clone()));
                let learned = outcomes.blocking_recv().expect("an outcome");
                passed += usize::from(learned.result.pass);
                assert_eq!(learned.result.changed_lookup, learned.new_lookup.is_some());
                if learned.result.pass {
                    let r = &learned.result;
                    println!(
                        "window {}: {} Hz, {:.3} ohm ± {:.2} %, {:.2} µH ± {:.2} %, {} steps, {:.0} ms",
                        r.seq,
                        r.f_sw_hz,
                        r.r_ohm,
                        r.sigma_r_pct,
                        r.l_h * 1e6,
                        r.sigma_l_pct,
                        r.iterations,
                        learned.busy.as_secs_f64() * 1e3
                    );
                }
                if let Some(built) = learned.new_lookup {
                    assert!(learned.state.is_some(), "a lookup without its state");
                    learner.lookup_accepted("hob", built.lookup.version);
                    lookups.push(built.lookup);
                }
                // The thread gives the learning back after the outcome.
                let until = Instant::now() + PATIENCE;
                saved = loop {
                    let state = learner.state_of("hob");
                    if state.is_some() || Instant::now() > until {
                        break state;
                    }
                };
            }
            learner.stop();
        }
        (lookups, passed)
    };
    let (whole, passed) = run(usize::MAX);
    assert!(passed >= windows.len() - 2, "{passed} of {}", windows.len());
    assert!(whole.len() >= 2, "{} lookups", whole.len());
    assert!(whole.windows(2).all(|w| w[1].version > w[0].version));
    let (restarted, _) = run(1);
    assert_eq!(restarted, whole);
}

#[test]
fn damaged_bytes_are_an_error_and_learning_restarts() {
    let (to, mut outcomes) = mpsc::channel(8);
    let learner = Learner::start(settings(1, 4), to).unwrap();
    assert!(learner.add("hob", Some(b"{\"format\":1")).is_err());
    let mut one = windows(false, &[1_500], 1);
    learner.offer(job("hob", one.remove(0)));
    assert!(outcomes.blocking_recv().is_some_and(|l| l.result.pass));
    learner.stop();
}
