//! Learning from windows of the simulated hob: restarts, and a pot that warms up.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_gate::Judgement;
use ihd_gate::claim::{ClaimError, ClaimedResult, confirm};
use ihd_identify::Preprocessing;
use ihd_link::{Client, DeviceEvent, Window};
use ihd_map::{CurveMatch, PotMap};
use ihd_pinn::{Identification, PinnConfig, StopReason};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{State, Telemetry};
use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::truth::{Mre, Truth};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::transport::SharedHob;
use ihd_sim::trial::Trial;

use super::lag::Lag;
use super::network::fit_window;
use super::{AnswerError, Learning, LookupUpdate, WindowOutcome, analyse_window, judge};
use crate::lookup::BuiltLookup;

fn network() -> PinnConfig {
    PinnConfig {
        deterministic: true,
        ..PinnConfig::default()
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
                DeviceEvent::Window(w)
                    if last.as_ref().is_some_and(|t| t.state == State::Heating) =>
                {
                    return (w, self.hob.lock().t_s());
                }
                DeviceEvent::Telemetry(t) => {
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

fn judged(segment: &Segment, identified: &Identification) -> Judgement {
    judge(segment, &Preprocessing::new(segment), identified, &[])
}

fn news(learning: &mut Learning, window: &Window) -> Option<RlLookup> {
    match learning.observe(window, false, &mut |_| ()) {
        WindowOutcome::Accepted(fit) => match fit.taught {
            LookupUpdate::Unchanged => None,
            LookupUpdate::New(built) => Some(built.lookup),
            LookupUpdate::Refused(why) => panic!("window {}: {why}", window.seq),
        },
        WindowOutcome::Refused { why, .. } => {
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
    for power_w in [1_500, 2_000, 900] {
        kitchen.client.set_power(power_w).unwrap();
        windows.extend((0..3).map(|_| kitchen.window().0));
    }
    let mut whole = Learning::new(network());
    let mut states = vec![whole.to_bytes()];
    let mut lookups = Vec::new();
    for window in &windows {
        let lookup = news(&mut whole, window);
        if let Some(lookup) = &lookup {
            whole.lookup_accepted(lookup.version);
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
            restored.lookup_accepted(lookup.version);
        }
        assert!(restored.to_bytes() == states[k + 1], "window {k}");
    }
    let bytes = states.last().map_or(0, Vec::len);
    println!("{} curves, {bytes} bytes", whole.curve_count());
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
                learning.lookup_accepted(lookup.version);
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
            learning.curve_count()
        );
    }
    (worst_r, worst_l, pushed)
}

#[test]
fn a_warming_pot_is_followed_and_no_lookup_refused() {
    let (r_pct, l_pct, pushed) = follow_a_warming_pot(0.1, 2.0);
    assert!(r_pct < 2.0 && l_pct < 2.0, "R {r_pct:.2} %, L {l_pct:.2} %");
    assert!(pushed >= 2);
}

#[test]
fn a_warming_pot_is_followed_at_length() {
    let (r_pct, l_pct, pushed) = follow_a_warming_pot(20.0, 45.0);
    assert!(r_pct < 2.0 && l_pct < 2.0, "R {r_pct:.2} %, L {l_pct:.2} %");
    assert!(pushed >= 5);
}

/// At one power R grows by .1 % a second: it is no other pot, and the map is not late.
#[test]
fn a_warming_pot_stays_the_same_and_its_map_is_not_late() {
    let mut kitchen = Kitchen::new(true, 20);
    let mut learning = Learning::new(network());
    kitchen.client.set_power(1_800).unwrap();
    let (mut squares, mut count) = ([0.0f64; 2], 0.0);
    for k in 0..60 {
        let (window, _) = kitchen.window();
        let outcome = learning.observe(&window, false, &mut |_| ());
        let WindowOutcome::Accepted(accepted) = outcome else {
            panic!("window {k}: {outcome:?}");
        };
        let another = matches!(accepted.seen, CurveMatch::Another { .. });
        assert!(!another, "window {k}: {:?}", accepted.seen);
        if k < 30 {
            continue;
        }
        let truth = kitchen.hob.truth(window.half_cycle).expect("recent");
        let most_a = truth.i_a.iter().copied().fold(0.0, f64::max);
        let now_s = learning.map().newest_s();
        let mut map = learning.map().clone();
        map.refresh(now_s);
        let at = map.along(f64::from(window.f_sw_hz), &truth.i_a, now_s);
        for (k, at) in at.iter().enumerate() {
            if truth.i_a[k] > 0.3 * most_a {
                squares[0] += (at.r_ohm / truth.r_ohm[k] - 1.0).powi(2);
                squares[1] += (at.l_h / truth.l_h[k] - 1.0).powi(2);
                count += 1.0;
            }
        }
    }
    let [r_pct, l_pct] = squares.map(|s| 100.0 * (s / count).sqrt());
    println!("rms of the map: R {r_pct:.3} %, L {l_pct:.3} %");
    assert!(
        r_pct < 0.15 && l_pct < 0.12,
        "R {r_pct:.3} %, L {l_pct:.3} %"
    );
}

/// Noise of the converters, 58 dB, is less than what sampling and network leave: at 30 dB that cannot show.
#[test]
fn deviations_of_a_window_are_those_of_its_errors() {
    let mut kitchen = Kitchen::new(false, 20);
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for power_w in [700, 1_000, 1_500, 2_000] {
        kitchen.client.set_power(power_w).unwrap();
        let window = kitchen.window().0;
        let truth = kitchen.hob.truth(window.half_cycle).expect("a recent one");
        let segment = window.segment();
        let found = fit_window(&segment, network(), &mut |_| ()).unwrap();
        for (k, t_s) in found.t_s.iter().enumerate() {
            if !(1e-3..9e-3).contains(t_s) {
                continue;
            }
            let (r_ohm, l_h) = truth.at(*t_s).expect("a time of the half-cycle");
            squares[0] += ((found.r_ohm[k] - r_ohm) / found.r_sigma_ohm[k]).powi(2);
            squares[1] += ((found.l_h[k] - l_h) / found.l_sigma_h[k]).powi(2);
            count += 1.0;
        }
    }
    let z = squares.map(|s| f64::sqrt(s / count));
    println!("root mean square of error/sigma: {z:.2?}");
    assert!(z.iter().all(|z| (0.3..1.6).contains(z)), "{z:.2?}");
}

/// The judge of `ihd identify` stands before the lookup: what least squares contradicts and what has not settled teach nothing.
#[test]
fn a_window_that_is_contradicted_teaches_nothing() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let segment = kitchen.window().0.segment();
    let found = fit_window(&segment, network(), &mut |_| ()).unwrap();
    let before = Instant::now();
    let right = judged(&segment, &found);
    println!("judged in {:.1} ms", before.elapsed().as_secs_f64() * 1e3);
    assert_eq!(right.gate.why, [""; 0]);
    let codes = |changed: &Identification| -> Vec<&str> {
        let judgement = judged(&segment, changed);
        assert!(!judgement.gate.passes());
        judgement.doubts().map(|d| d.code).collect()
    };
    let mut off = found.clone();
    off.r_ohm.iter_mut().for_each(|r| *r *= 1.03);
    assert!(codes(&off).contains(&"disagreement"));
    // A limit of steps that was met at the right place is told; at a wrong one it is one more reason.
    let mut unsettled = found.clone();
    unsettled.stopped_because = StopReason::TimeLimit;
    let judgement = judged(&segment, &unsettled);
    assert_eq!(judgement.gate.why, [""; 0]);
    assert!(judgement.findings.iter().any(|f| f.code == "not_converged"));
    off.stopped_because = StopReason::TimeLimit;
    assert!(codes(&off).contains(&"not_converged"));
    // A reading of the current a tenth of what it is: no cell of a lookup holds ten times L.
    let tenth = segment.i_a.iter().map(|i| 0.1 * i).collect();
    let segment = segment.with_samples(segment.v_v.to_vec(), tenth);
    let found = fit_window(&segment, network(), &mut |_| ()).unwrap();
    let judgement = judged(&segment, &found);
    assert!(!judgement.gate.passes());
    assert!(judgement.doubts().any(|d| d.code == "implausible_load"));
}

/// Processor time of this thread in seconds, where the system tells it.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

/// The figure of docs/performance.md: `cargo test -p ihd-train --features pinn fits_of_a_core -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, whatever it gives"]
fn fits_of_a_core() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let windows: Vec<_> = (0..10).map(|_| kitchen.window().0).collect();
    for (first, preset) in [(0_u32, "hybrid"), (1_000, "hybrid"), (1_000, "at-once")] {
        let mut learning = Learning::new(PinnConfig {
            deterministic: true,
            ..PinnConfig::from_toml(&format!("preset = {preset:?}")).unwrap()
        });
        let mut times = Vec::new();
        for (seq, window) in (first..).zip(windows.iter().cycle()).take(81) {
            let window = Window {
                seq: if first == 0 { seq % 32 } else { seq },
                ..(**window).clone()
            };
            let before = processor_s().expect("Linux");
            if let Some(lookup) = news(&mut learning, &window) {
                learning.lookup_accepted(lookup.version);
            }
            times.push(1e3 * (processor_s().expect("Linux") - before));
        }
        // A new pot's first windows all count for its lag.
        let cold = times.drain(..17).next().unwrap();
        let mean = times.iter().sum::<f64>() / times.len() as f64;
        println!(
            "{preset}, from window {first}: {cold:.0} ms cold, {mean:.1} ms warm, {:.0} windows a second of one core",
            1e3 / mean
        );
    }
}

/// The figures of docs/fleet.md: `cargo test --release -p ihd-train --features pinn cost_of_an_answer -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, whatever it gives"]
fn cost_of_an_answer() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let mut windows: Vec<_> = (0..20).map(|_| kitchen.window().0).collect();
    // Of a hob that has been on for a while.
    windows.iter_mut().for_each(|window| window.seq += 1_000);
    let (mut worker_s, mut check_s, mut edge_s) = (0.0, 0.0, 0.0);
    let mut learning = Learning::new(network());
    let timed = |sum: &mut f64, what: &mut dyn FnMut()| {
        let before = processor_s().expect("Linux");
        what();
        *sum += processor_s().expect("Linux") - before;
    };
    for window in &windows[4..] {
        let correction = learning.correction();
        let mut found = None;
        timed(&mut worker_s, &mut || {
            found = analyse_window(window, correction.as_ref(), network()).identified;
        });
        let found = found.expect("a heating hob's window");
        let segment = window.segment();
        timed(&mut check_s, &mut || {
            confirm(&segment, &claim_of(&found)).unwrap();
        });
        timed(&mut edge_s, &mut || {
            learning
                .learn_from_answer(7, window, &claim_of(&found))
                .unwrap();
        });
    }
    let ms = |sum: f64| 1e3 * sum / 16.0;
    println!(
        "worker {:.1} ms; edge {:.1} ms a window, of which the check {:.2} ms",
        ms(worker_s),
        ms(edge_s),
        ms(check_s)
    );
}

/// Mean relative errors of R and L in percent, over the whole half-cycle and the middle 80 %.
type Both = [(f64, f64); 2];

fn errors(truth: &Truth, times: impl Iterator<Item = (f64, f64, f64)> + Clone) -> Both {
    [(0.0, 10e-3), (1e-3, 9e-3)].map(|(from_s, to_s)| {
        let mre =
            Mre::compute(truth, times.clone(), from_s, to_s).expect("times within the half-cycle");
        (mre.r_pct, mre.l_pct)
    })
}

/// Half-cycles of one pot at 30 dB, one after the other: errors of each network, and of what all until then say.
fn learn_at_30_db(load: LoadKind, f_sw_hz: f64, windows: u64) -> Vec<[Both; 2]> {
    let trial = Trial::simulate(load, f_sw_hz).unwrap();
    let (mut map, mut lag) = (PotMap::default(), Lag::default());
    let mut found = Vec::new();
    for seed in 0..windows {
        let noisy = trial.noisy(Some(30.0), seed);
        let (from, to) = noisy.half_cycles()[1];
        let crossing_s = noisy.crossing_of_s((from, to));
        let mut segment = noisy.part(from, to);
        segment.t0_s -= crossing_s;
        segment.zero_crossing_s = 0.0;
        let identified = fit_window(&segment, network(), &mut |_| ()).unwrap();
        let t_s = 0.2 * seed as f64;
        let seen = map.observe(super::network::curve(
            &segment,
            WhiteNoise::measure(&segment),
            &(&identified).into(),
            t_s,
        ));
        let same = matches!(seen, CurveMatch::First | CurveMatch::Same { .. });
        assert!(same, "window {seed}: {seen:?}");
        map.refresh(t_s);
        lag.add_window(
            &identified,
            &map.along(f_sw_hz, &identified.i_amplitude_a, t_s),
        );
        let learned = map.along(f_sw_hz, &lag.lagged_currents_a(&identified), t_s);
        let truth = {
            let of = trial
                .truth
                .iter()
                .filter(|p| (crossing_s..crossing_s + 10e-3).contains(&p.t_s));
            let at: Vec<_> = of.collect();
            Truth {
                t_s: at.iter().map(|p| p.t_s - crossing_s).collect(),
                i_a: at.iter().map(|p| p.i_a).collect(),
                r_ohm: at.iter().map(|p| p.r_ohm[0]).collect(),
                l_h: at.iter().map(|p| p.l_h[0]).collect(),
                ..Truth::default()
            }
        };
        let times = &identified.t_s;
        let alone = times.iter().zip(&identified.r_ohm).zip(&identified.l_h);
        let all = times.iter().zip(&learned);
        println!("lag {:.2} µs", 1e6 * lag.seconds());
        found.push([
            errors(&truth, alone.map(|((t, r), l)| (*t, *r, *l))),
            errors(&truth, all.map(|(t, p)| (*t, p.r_ohm, p.l_h))),
        ]);
    }
    found
}

/// The goal of the issue: whole half-cycle within .07/.05 % after ten windows; with the law's form known the bound of one
/// window is .050/.039 % (docs/map.md).
#[test]
fn ten_windows_at_30_db_know_the_whole_half_cycle() {
    for f_sw_hz in [45e3, 70e3] {
        let found = learn_at_30_db(LoadKind::Behavioural, f_sw_hz, 10);
        for (k, [alone, all]) in found.iter().enumerate() {
            println!(
                "{f_sw_hz} Hz, {} windows: network alone {alone:.3?}, all {all:.3?} %",
                k + 1
            );
        }
        let [_, [(r_pct, l_pct), _]] = found[9];
        assert!(
            r_pct <= 0.07 && l_pct <= 0.05,
            "R {r_pct:.3} %, L {l_pct:.3} %"
        );
    }
}

#[test]
fn a_load_is_forgotten_and_what_other_hobs_know_is_not() {
    let mut learning = Learning::new(PinnConfig::default());
    assert!(learning.map().library().is_none());
    learning.use_library(Arc::default());
    learning.forget();
    assert!(learning.map().library().is_some());
    // The library is nobody's state: whoever restores one gives it again.
    let restored = Learning::from_bytes(&learning.to_bytes(), PinnConfig::default()).unwrap();
    assert!(restored.map().library().is_none());
}

fn claim_of(found: &Identification) -> ClaimedResult<'_> {
    ClaimedResult {
        t_s: &found.t_s,
        r_ohm: &found.r_ohm,
        l_h: &found.l_h,
    }
}

/// The specification of a worker: what it finds in a window is what the device's own learning would have found, whatever came before and in
/// whatever order its results come; one of a pot that may be gone teaches nothing.
#[test]
fn an_answer_teaches_as_if_it_had_been_found_here() {
    let mut kitchen = Kitchen::new(false, 20);
    let mut windows = Vec::new();
    for power_w in [1_500, 2_000, 900] {
        kitchen.client.set_power(power_w).unwrap();
        windows.extend((0..4).map(|_| kitchen.window().0));
    }
    let (mut here, mut there) = (Learning::new(network()), Learning::new(network()));
    let mut answers = Vec::new();
    for window in &windows {
        news(&mut here, window);
        let alone = analyse_window(window, there.correction().as_ref(), network());
        if alone.refused.is_none() {
            answers.push((window, alone.identified.unwrap()));
        }
    }
    assert!(answers.len() >= 9, "{} of {}", answers.len(), windows.len());
    // As from two workers of which one is slower.
    answers.swap(4, 5);
    answers.swap(6, 8);
    for (window, found) in &answers {
        let believed = there
            .learn_from_answer(7, window, &claim_of(found))
            .unwrap();
        assert!(believed.seen.is_some(), "seconds are not too late");
    }
    let now_s = here.map().newest_s();
    let cells = |learning: &Learning| learning.map().cells(now_s).unwrap();
    let lookups =
        [&here, &there].map(|learning| BuiltLookup::from_cells(cells(learning), 1).unwrap().lookup);
    for f_hz in [40_000, 50_000, 60_000] {
        let [a, b] = lookups.each_ref().map(|l| l.interpolate(f_hz, 20_000));
        let r = b.0.ohm() / a.0.ohm() - 1.0;
        let l = b.1.henry() / a.1.henry() - 1.0;
        assert!(r.abs() < 5e-3 && l.abs() < 3e-3, "{f_hz} Hz: R {r}, L {l}");
    }
    // After one of a minute later, the first says what may be gone.
    let (last, found) = answers.last().unwrap();
    let mut later = (**last).clone();
    later.half_cycle += 6_000;
    there
        .learn_from_answer(7, &later, &claim_of(found))
        .unwrap();
    let before = there.map().clone();
    let (first, found) = &answers[0];
    let believed = there.learn_from_answer(7, first, &claim_of(found)).unwrap();
    assert!(believed.seen.is_none());
    assert_eq!(there.map().curves(), before.curves());
}

/// Windows with what a worker finds in them, of those that the gate accepts.
fn answered(kitchen: &mut Kitchen, count: usize) -> Vec<(Window, Identification)> {
    let windows = std::iter::repeat_with(|| *kitchen.window().0);
    let found = windows.take(2 * count).filter_map(|window| {
        let alone = analyse_window(&window, None, network());
        let identified = alone.identified.filter(|_| alone.refused.is_none());
        Some((window, *identified?))
    });
    found.take(count).collect()
}

/// The pot of an earlier boot may be gone, whenever its windows are answered and whatever was restarted meanwhile.
#[test]
fn an_answer_to_an_earlier_boot_teaches_nothing() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let answers: [_; 3] = answered(&mut kitchen, 3).try_into().unwrap();
    let [first, second, third] = &answers;
    let mut learning = Learning::new(network());
    learning.begin_boot(7);
    let tell = |learning: &mut Learning, boot, (window, found): &(Window, Identification)| {
        let told = learning.learn_from_answer(boot, window, &claim_of(found));
        told.unwrap().seen
    };
    assert!(tell(&mut learning, 7, first).is_some());
    learning.begin_boot(8);
    assert!(learning.map().newest_s() <= 0.0, "older than the new boot");
    let mut restored = Learning::from_bytes(&learning.to_bytes(), network()).unwrap();
    for learning in [&mut learning, &mut restored] {
        let before = learning.to_bytes();
        assert_eq!(tell(learning, 7, second), None);
        assert_eq!(learning.to_bytes(), before);
        assert!(!learning.is_present(7) && learning.is_present(8));
        assert!(tell(learning, 8, third).is_some());
        learning.forget();
        assert_eq!(
            tell(learning, 7, second),
            None,
            "forgotten is the load alone"
        );
    }
}

/// Half-cycles differ by some 1e-4. Two windows of a second are no further apart after a year than at the start.
#[test]
fn times_of_a_hob_that_has_been_on_for_long_are_those_between_its_windows() {
    let mut kitchen = Kitchen::new(false, 20);
    kitchen.client.set_power(1_500).unwrap();
    let mut learning = Learning::new(network());
    let mut newest_s = None;
    for (k, (mut window, found)) in (0..).zip(answered(&mut kitchen, 4)) {
        window.half_cycle += 365 * 8_640_000;
        window.half_cycle_ns = 10_000_000 + [3_700, 0, 7_400, 1_000][k];
        let told = learning.learn_from_answer(7, &window, &claim_of(&found));
        assert!(told.unwrap().seen.is_some(), "window {k} is late");
        let now_s = learning.map().newest_s();
        let since_s = now_s - newest_s.replace(now_s).unwrap_or(now_s);
        assert!(
            (0.0..3.0).contains(&since_s),
            "window {k}: {since_s} s later"
        );
    }
}

/// Makes a lie of honest R and L, at a place of the half-cycle from -.5 to .5.
type Lie = fn(f64, &mut f64, &mut f64);

const LIES: [(&str, Lie); 8] = [
    ("R 2 % high", |_, r, _| *r *= 1.02),
    ("R 1 % low", |_, r, _| *r *= 0.99),
    ("R ten times", |_, r, _| *r *= 10.0),
    ("L 1 % high", |_, _, l| *l *= 1.01),
    ("R and L exchanged", |_, r, l| (*r, *l) = (*l, *r)),
    ("no number", |_, r, _| *r = f64::NAN),
    ("R 3 % high at the crest, the mean right", |x, r, _| {
        *r *= 1.0 + 0.03 * (6.0 * std::f64::consts::PI * x).cos();
    }),
    ("skew of 200 ns", |_, r, l| {
        *r += (2.0 * std::f64::consts::PI * 45e3).powi(2) * *l * 200e-9
    }),
];

/// An honest answer is confirmed at every power, and no lie moves what was learned.
#[test]
fn a_lie_is_refuted_by_the_samples_and_moves_nothing() {
    let mut kitchen = Kitchen::new(false, 20);
    let mut learning = Learning::new(network());
    for power_w in [600, 1_200, 2_000] {
        kitchen.client.set_power(power_w).unwrap();
        let windows: Vec<_> = (0..4).map(|_| kitchen.window().0).collect();
        for window in &windows[3..] {
            let found = analyse_window(window, learning.correction().as_ref(), network());
            let found = *found.identified.unwrap();
            let believed = learning
                .learn_from_answer(7, window, &claim_of(&found))
                .unwrap();
            println!(
                "{power_w} W: honest, differs {:.3?} %",
                believed.confirmed.differs_pct
            );
            let before = learning.to_bytes();
            for (name, lie) in LIES {
                let mut told = found.clone();
                let n = told.t_s.len();
                for k in 0..n {
                    let x = k as f64 / n as f64 - 0.5;
                    lie(x, &mut told.r_ohm[k], &mut told.l_h[k]);
                }
                let why = learning
                    .learn_from_answer(7, window, &claim_of(&told))
                    .unwrap_err();
                println!("  {name}: {why}");
                assert!(matches!(why, AnswerError::Refuted(_)), "{name}: {why}");
                assert_eq!(learning.to_bytes(), before, "{name}");
            }
            let half = ClaimedResult {
                t_s: &found.t_s[..found.t_s.len() / 2],
                r_ohm: &found.r_ohm[..found.t_s.len() / 2],
                l_h: &found.l_h[..found.t_s.len() / 2],
            };
            let why = learning.learn_from_answer(7, window, &half).unwrap_err();
            assert!(
                matches!(why, AnswerError::Refuted(ClaimError::NotCovered { .. })),
                "{why}"
            );
        }
    }
}

/// The check's own error, over loads, frequencies and noise: what an honest answer differs by.
#[test]
fn honest_answers_are_confirmed_whatever_the_load() {
    for (load, f_sw_hz) in [
        (LoadKind::Field, 45e3),
        (LoadKind::Behavioural, 80e3),
        (LoadKind::Surrogate, 30e3),
    ] {
        honest_answer_is_confirmed(load, f_sw_hz, &[None, Some(30.0)]);
    }
}

#[test]
fn honest_answers_are_confirmed_whatever_the_load_all_variants() {
    for load in [LoadKind::Field, LoadKind::Behavioural, LoadKind::Surrogate] {
        for f_sw_hz in [30e3, 45e3, 80e3] {
            let noises_db = [None, Some(50.0), Some(40.0), Some(30.0)];
            honest_answer_is_confirmed(load, f_sw_hz, &noises_db);
        }
    }
}

fn honest_answer_is_confirmed(load: LoadKind, f_sw_hz: f64, noises_db: &[Option<f64>]) {
    let trial = Trial::simulate(load, f_sw_hz).unwrap();
    for (seed, &snr_db) in noises_db.iter().enumerate() {
        let noisy = trial.noisy(snr_db, seed as u64);
        let (from, to) = noisy.half_cycles()[1];
        let crossing_s = noisy.crossing_of_s((from, to));
        let mut segment = noisy.part(from, to);
        segment.t0_s -= crossing_s;
        segment.zero_crossing_s = 0.0;
        let found = fit_window(&segment, network(), &mut |_| ()).unwrap();
        let confirmed = confirm(&segment, &claim_of(&found)).unwrap();
        println!(
            "{load:?} {f_sw_hz} Hz {snr_db:?} dB: {:.4?} %",
            confirmed.differs_pct
        );
    }
}
