//! Content of the link while the firmware heats the simulated plant: windows, lookups, and what a
//! slow or a repeated run changes.

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_link::{DeviceEvent, FrameSink, LinkError, Window};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::f_adc_hz;
use ihd_shared::wire::messages::{Outcome, State, Telemetry};
use ihd_signal::truth::Mre;
use ihd_sim::hob::HobConfig;
use ihd_tests::simulated_hob::Kitchen;

fn windows(events: &[DeviceEvent]) -> impl Iterator<Item = &Window> {
    events.iter().filter_map(|e| match e {
        DeviceEvent::Window(window) => Some(&**window),
        _ => None,
    })
}

/// Largest error of both ends of a half-cycle together: four sigma of the mains converter's noise, one
/// code or 2 µs each (`ihd_sim::slow_adc`), and the line's ringing with C1, a volt or 10 µs each.
const CROSSING_S: f64 = 30e-6;

/// Errors of a window's track over the middle 80 %, against the half-cycle's truth.
fn track_error(kitchen: &Kitchen, window: &Window) -> Mre {
    let half_cycle_s = f64::from(window.half_cycle_ns) * 1e-9;
    let truth = kitchen
        .hob
        .truth(window.half_cycle)
        .expect("a recent half-cycle");
    assert_eq!(truth.f_sw_hz, f64::from(window.f_sw_hz));
    let track = window.trajectory.iter().enumerate();
    let track = track.map(|(k, e)| (window.trajectory_time_s(k), e.r.ohm(), e.l.henry()));
    Mre::compute(&truth, track, 0.1 * half_cycle_s, 0.9 * half_cycle_s).expect("a track")
}

#[test]
fn windows_hold_the_truth_of_their_half_cycle() {
    for (mains_hz, powers_w) in [(50.0, [700, 2_200].as_slice()), (60.0, &[1_500])] {
        let mut kitchen = Kitchen::new(HobConfig {
            mains_hz,
            ..HobConfig::default()
        });
        // One window takes up to 170 ms of the link.
        kitchen.client.stream(1, 20).unwrap();
        for &asked_w in powers_w {
            kitchen.client.set_power(asked_w).unwrap();
            kitchen.watch(60);
            kitchen.events.clear();
            let telemetry = kitchen.watch(80);
            let events = std::mem::take(&mut kitchen.events);
            assert!(windows(&events).count() >= 3, "{asked_w} W");
            for window in windows(&events).filter(|w| w.half_cycle >= telemetry[0].half_cycle) {
                let pairs = f_adc_hz(window.f_sw_hz) * 0.5 / mains_hz;
                let extra = window.pairs.len() as f64 - pairs;
                assert!(
                    extra.abs() <= 1.0 + CROSSING_S * f_adc_hz(window.f_sw_hz),
                    "{extra}"
                );
                let off_s = (0.5 / window.f_mains_hz() - 0.5 / mains_hz).abs();
                assert!(off_s < CROSSING_S, "{off_s}");
                assert_eq!(window.saturated, 0);
                let at = window.half_cycle - telemetry[0].half_cycle;
                assert_eq!(window.f_sw_hz, telemetry[at as usize].f_sw_hz);
                let mre = track_error(&kitchen, window);
                println!("{mains_hz} Hz, {asked_w} W, {} Hz: {mre:?}", window.f_sw_hz);
                assert!(mre.r_pct <= 1.0 && mre.l_pct <= 0.5, "{asked_w} W: {mre:?}");
            }
        }
        assert_eq!(kitchen.client.counters().windows_rejected_total(), 0);
        assert_eq!(kitchen.client.counters().windows.missing, 0);
    }
}

/// A plausible lookup that is not the built-in one: R 5 % higher.
fn taught(version: u32) -> RlLookup {
    let mut lookup = RlLookup { version, ..prior() };
    for cell in lookup.r.iter_mut().flatten() {
        *cell += *cell / 20;
    }
    lookup
}

/// Heating at the asked power.
fn assert_heats(seen: &[Telemetry], asked_w: f64) {
    for t in seen {
        assert_eq!(t.state, State::Heating, "{t:?}");
        let power_w = f64::from(t.power_mw) * 1e-3;
        assert!((power_w / asked_w - 1.0).abs() <= 0.03, "{power_w} W");
    }
}

#[test]
fn a_lookup_becomes_active_at_the_next_half_cycle() {
    let mut kitchen = Kitchen::heating(1_200);
    // Away from the boundary, so that the answers come before it.
    let middle_s = kitchen.hob.lock().t_s() + 3e-3;
    while kitchen.hob.lock().t_s() < middle_s {
        kitchen.hob.lock().step();
    }
    kitchen.client.push_lookup(&taught(1)).unwrap();
    assert_eq!(kitchen.client.status().unwrap().lookup_version, 0);
    assert_eq!(kitchen.client.read_lookup().unwrap(), prior());
    let seen = kitchen.watch(20);
    assert!(seen.iter().all(|t| t.lookup_version == 1), "{:?}", seen[0]);
    assert_eq!(kitchen.client.read_lookup().unwrap(), taught(1));
    assert_heats(&seen, 1_200.0);
}

#[test]
fn a_bad_lookup_leaves_the_old_one_and_the_heating_goes_on() {
    let mut kitchen = Kitchen::heating(1_200);
    kitchen.client.push_lookup(&taught(1)).unwrap();
    kitchen.watch(2);
    let mut damaged = taught(2).to_bytes();
    damaged[100] ^= 1;
    let mut steep = taught(2);
    steep.r[3][5] /= 2;
    for (bytes, expected) in [
        (&damaged[..], Outcome::LookupCrc),
        (&damaged[..200], Outcome::LookupLength),
        (&taught(1).to_bytes(), Outcome::LookupStale),
        (&steep.to_bytes(), Outcome::LookupSlope),
    ] {
        match kitchen.client.push_lookup_bytes(bytes) {
            Err(LinkError::Refused { outcome, .. }) => assert_eq!(outcome, expected),
            other => panic!("{expected:?}: {other:?}"),
        }
        let seen = kitchen.watch(10);
        assert!(seen.iter().all(|t| t.lookup_version == 1));
        assert_heats(&seen, 1_200.0);
        assert_eq!(kitchen.client.read_lookup().unwrap(), taught(1));
    }
}

/// A recording that the test can look at.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl FrameSink for Shared {
    fn received(&mut self, _: Duration, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(())
    }

    fn sent(&mut self, _: Duration, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        Ok(())
    }
}

/// Everything a hob sends in 60 half-cycles at two powers. The hello comes before the recording.
fn recorded(seed: u64) -> Vec<u8> {
    let sink = Shared::default();
    let mut kitchen = Kitchen::new(HobConfig {
        seed,
        ..HobConfig::default()
    });
    kitchen.client.record_to(sink.clone());
    kitchen.client.stream(1, 10).unwrap();
    for power_w in [1_500, 900] {
        kitchen.client.set_power(power_w).unwrap();
        kitchen.watch(30);
    }
    sink.0.lock().unwrap().clone()
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_one_others() {
    let first = recorded(1);
    assert!(first.len() > 100_000, "{} bytes", first.len());
    // No assert_eq: nobody wants to read what differs.
    assert!(
        first == recorded(1),
        "the same seed must give the same bytes"
    );
    assert!(first != recorded(2), "another seed must give other bytes");
}

/// 100 half-cycles over a link of some speed, power asked for at the same instant.
fn over(link_bytes_per_s: f64) -> (Kitchen, Vec<Telemetry>) {
    let mut kitchen = Kitchen::new(HobConfig {
        link_bytes_per_s,
        ..HobConfig::default()
    });
    kitchen.client.stream(1, 5).unwrap();
    while kitchen.hob.lock().t_s() < 0.105 {
        kitchen.hob.lock().step();
    }
    kitchen.client.set_power(1_500).unwrap();
    kitchen.watch(100);
    let telemetry = kitchen.events.iter().filter_map(|e| match e {
        DeviceEvent::Telemetry(t) if t.half_cycle >= 10 => Some(t.clone()),
        _ => None,
    });
    let telemetry = telemetry.take(80).collect();
    (kitchen, telemetry)
}

#[test]
fn a_slow_link_loses_windows_and_no_control() {
    let (mut fast, fast_run) = over(2e6);
    let (mut slow, slow_run) = over(100e3);
    // Bit for bit the same half-cycles, estimates included.
    assert_eq!(fast_run.len(), 80);
    assert!(
        fast_run == slow_run,
        "{:?} {:?}",
        fast_run.last(),
        slow_run.last()
    );
    assert_heats(&fast_run[60..], 1_500.0);
    assert_eq!(fast.client.status().unwrap().windows_dropped, 0);
    assert!(windows(&slow.events).count() >= 1);
    let (status, counters) = (slow.client.status().unwrap(), slow.client.counters());
    assert!(status.windows_dropped > 5, "{status:?}");
    assert!(counters.windows.missing > 0 && counters.windows.dropped_by_device > 0);
    assert_eq!(counters.telemetry.missing, 0);
}
