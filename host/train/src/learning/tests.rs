//! Learning from windows of the simulated hob: restarts, and a pot that warms up.

use std::time::{Duration, Instant};

use ihd_link::{Client, Event, Window};
use ihd_pinn::{Config, Identified, StoppedBecause};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{State, Telemetry};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

use super::network::identify_window;
use super::{Learning, Outcome, Taught, judge};

fn network() -> Config {
    Config {
        deterministic: true,
        ..Config::default()
    }
}

/// A simulated hob, and a client of it.
struct Kitchen {
    hob: SharedHob,
    client: Client,
}

impl Kitchen {
    fn new(warming: bool, windows_every: u8) -> Self {
        let hob = SharedHob::new(SimHob::new(&HobConfig {
            warming,
            ..HobConfig::default()
        }));
        let mut client = Client::connect(Box::new(hob.clone())).unwrap();
        client.stream(1, windows_every).unwrap();
        Self { hob, client }
    }

    /// The next window of a half-cycle in which the hob heats, and when it ended, in seconds.
    fn window(&mut self) -> (Box<Window>, f64) {
        let mut last: Option<Telemetry> = None;
        loop {
            let event = self.client.next_event(Duration::from_secs(5)).unwrap();
            match event.expect("the hob is silent") {
                Event::Window(w) if last.as_ref().is_some_and(|t| t.state == State::Heating) => {
                    return (w, self.hob.lock().t_s());
                }
                Event::Telemetry(t) => {
                    if t.half_cycle.is_multiple_of(200) {
                        self.client.status().unwrap();
                    }
                    last = Some(t);
                }
                _ => {}
            }
        }
    }
}

fn news(learning: &mut Learning, window: &Window) -> Option<RlLookup> {
    match learning.observe(window, false, &mut |_| ()) {
        Outcome::Fit(fit) => match fit.taught {
            Taught::Known => None,
            Taught::News(built) => Some(built.lookup),
            Taught::Refused(why) => panic!("window {}: {why}", window.seq),
        },
        Outcome::Unfit { why, .. } => {
            println!("window {}: {why}", window.seq);
            None
        }
    }
}

/// The specification of a restart: interrupted after any window, the lookups are the same, bit for bit.
#[test]
fn restored_after_any_window_it_learns_the_same() {
    let mut kitchen = Kitchen::new(false, 20);
    let mut windows = Vec::new();
    for power_w in [1_500, 2_000, 900, 1_500] {
        kitchen.client.set_power(power_w).unwrap();
        windows.extend((0..4).map(|_| kitchen.window().0));
    }
    let mut whole = Learning::new(network());
    let mut states = vec![whole.to_bytes()];
    let mut lookups = Vec::new();
    for window in &windows {
        let lookup = news(&mut whole, window);
        if let Some(lookup) = &lookup {
            whole.accepted(lookup.version);
        }
        lookups.push(lookup);
        states.push(whole.to_bytes());
    }
    assert!(lookups.iter().flatten().count() >= 2, "nothing to compare");
    // One that is restored after every window is restored after any.
    for (k, window) in windows.iter().enumerate() {
        let mut restored = Learning::from_bytes(&states[k], network()).unwrap();
        assert_eq!(restored.to_bytes(), states[k], "window {k}");
        let lookup = news(&mut restored, window);
        assert_eq!(lookup, lookups[k], "window {k}");
        if let Some(lookup) = &lookup {
            restored.accepted(lookup.version);
        }
        assert!(restored.to_bytes() == states[k + 1], "window {k}");
    }
    let bytes = states.last().map_or(0, Vec::len);
    println!("{} curves, {bytes} bytes", whole.curves());
}

/// Heats a warming pot with changing powers, each for some seconds, and follows it; largest errors of the active lookup at the working
/// point in percent, and how many lookups the device took.
fn follow_a_warming_pot(minutes: f64, at_each_s: f64) -> (f64, f64, u32) {
    let mut kitchen = Kitchen::new(true, 100);
    let mut learning = Learning::new(network());
    let (mut worst_r, mut worst_l, mut pushed) = (0.0f64, 0.0f64, 0);
    let mut active: Option<RlLookup> = None;
    let mut now_s = 0.0;
    for power_w in [1_500, 2_000, 1_000, 700, 1_800].into_iter().cycle() {
        if now_s > 60.0 * minutes {
            break;
        }
        kitchen.client.set_power(power_w).unwrap();
        let until_s = now_s + at_each_s;
        while now_s < until_s {
            let (window, at_s) = kitchen.window();
            now_s = at_s;
            if let Some(lookup) = news(&mut learning, &window) {
                kitchen.client.push_lookup(&lookup).unwrap();
                learning.accepted(lookup.version);
                active = Some(lookup);
                pushed += 1;
            }
            let truth = kitchen
                .hob
                .truth(window.half_cycle)
                .expect("a recent half-cycle");
            let crest = (0..truth.i_a.len()).max_by(|&a, &b| truth.i_a[a].total_cmp(&truth.i_a[b]));
            let k = crest.expect("a half-cycle with current");
            let lookup = active.as_ref().expect("the first window is news");
            let (r, l) = lookup.interpolate(window.f_sw_hz, (truth.i_a[k] * 1e3) as u32);
            let r_pct = 100.0 * (r.ohm() / truth.r_ohm[k] - 1.0).abs();
            let l_pct = 100.0 * (l.henry() / truth.l_h[k] - 1.0).abs();
            worst_r = worst_r.max(r_pct);
            worst_l = worst_l.max(l_pct);
        }
        println!(
            "{now_s:.0} s, {power_w} W: {pushed} lookups, {} curves, worst R {worst_r:.2} %, L {worst_l:.2} %",
            learning.curves()
        );
    }
    (worst_r, worst_l, pushed)
}

#[test]
fn a_warming_pot_is_followed_and_no_lookup_refused() {
    // Simulated minutes take as long on a slow machine.
    let (r_pct, l_pct, pushed) = follow_a_warming_pot(0.7, 10.0);
    assert!(r_pct < 2.0 && l_pct < 2.0, "R {r_pct:.2} %, L {l_pct:.2} %");
    assert!(pushed >= 2);
}

#[test]
#[ignore = "twenty minutes of the hob take some minutes; run with --ignored"]
fn a_warming_pot_is_followed_for_twenty_minutes() {
    let (r_pct, l_pct, pushed) = follow_a_warming_pot(20.0, 45.0);
    assert!(r_pct < 2.0 && l_pct < 2.0, "R {r_pct:.2} %, L {l_pct:.2} %");
    assert!(pushed >= 5);
}

/// The judge of `ihd identify` stands before the lookup: what least squares contradicts and what has not settled teach nothing.
#[test]
fn a_window_that_is_contradicted_teaches_nothing() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let segment = kitchen.window().0.segment();
    let found = identify_window(&segment, network(), &mut |_| ()).unwrap();
    let before = Instant::now();
    let right = judge(&segment, &found, &[]);
    println!("judged in {:.1} ms", before.elapsed().as_secs_f64() * 1e3);
    assert_eq!(right.gate.why, [""; 0]);
    let codes = |changed: &Identified| -> Vec<&str> {
        let judgement = judge(&segment, changed, &[]);
        assert!(judgement.gate.refuses());
        judgement.doubts().map(|d| d.code).collect()
    };
    let mut off = found.clone();
    off.r_ohm.iter_mut().for_each(|r| *r *= 1.03);
    assert!(codes(&off).contains(&"disagreement"));
    // A limit of steps that was met at the right place is told; at a wrong one it is one more reason.
    let mut unsettled = found.clone();
    unsettled.stopped_because = StoppedBecause::TimeLimit;
    let judgement = judge(&segment, &unsettled, &[]);
    assert_eq!(judgement.gate.why, [""; 0]);
    assert!(judgement.findings.iter().any(|f| f.code == "not_converged"));
    off.stopped_because = StoppedBecause::TimeLimit;
    assert!(codes(&off).contains(&"not_converged"));
    // A reading of the current a tenth of what it is: no cell of a lookup holds ten times L.
    let tenth = segment.i_a.iter().map(|i| 0.1 * i).collect();
    let segment = segment.with_samples(segment.v_v.clone(), tenth);
    let found = identify_window(&segment, network(), &mut |_| ()).unwrap();
    let judgement = judge(&segment, &found, &[]);
    assert!(judgement.gate.refuses());
    assert!(judgement.doubts().any(|d| d.code == "implausible_load"));
}

/// Processor time of this thread in seconds, where the system tells it.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

/// The figure of docs/daemon.md: `cargo test --release -p ihd-train --features pinn fits_of_a_core -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, whatever it gives"]
fn fits_of_a_core() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let windows: Vec<_> = (0..10).map(|_| kitchen.window().0).collect();
    let mut learning = Learning::new(network());
    let mut times = Vec::new();
    for window in windows.iter().cycle().take(60) {
        let before = processor_s().expect("Linux");
        if let Some(lookup) = news(&mut learning, window) {
            learning.accepted(lookup.version);
        }
        times.push(processor_s().expect("Linux") - before);
    }
    let cold = times.remove(0);
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    println!(
        "{:.0} ms cold, {:.1} ms warm, {:.1} windows a second of one core",
        cold * 1e3,
        mean * 1e3,
        1.0 / mean
    );
}
