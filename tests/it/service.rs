//! Requests to the simulated hob besides heating (protocol 2.2), through the client.

use std::time::Duration;

use ihd_link::{Client, DeviceEvent, LinkError};
use ihd_shared::wire::messages::{Outcome, Program, State};
use ihd_sim::adc::ConverterNoise;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::transport::SharedHob;

fn connected(config: &HobConfig) -> (Client, SharedHob) {
    let hob = SharedHob::new(SimHob::new(config));
    (Client::connect(Box::new(hob.clone())).unwrap(), hob)
}

fn outcome<T: std::fmt::Debug>(result: Result<T, LinkError>) -> Outcome {
    match result {
        Err(LinkError::Refused { outcome, .. }) => outcome,
        other => panic!("{other:?}"),
    }
}

/// Lets simulated time pass.
fn wait(client: &mut Client, time: Duration) {
    let until = client.clock() + time;
    while client.clock() < until {
        let left = until.saturating_sub(client.clock());
        client.next_event(left).unwrap();
    }
}

#[test]
fn a_simulated_hob_has_no_chip_and_the_option_bytes_that_it_needs() {
    let (mut client, _) = connected(&HobConfig::default());
    let facts = client.board().unwrap();
    assert_eq!((facts.id_code, facts.starts), (0, 1));
    assert!(facts.build_id.is_empty() && facts.chip.is_empty());
    // DBANK is bit 22, SRAM_PE bit 24 (RM0440, FLASH_OPTR).
    assert_eq!(facts.option_bytes & 1 << 22, 1 << 22);
    assert_eq!(facts.option_bytes & 1 << 24, 0);
}

#[test]
fn the_channels_show_the_noise_that_was_put_in_and_the_mains() {
    let (mut client, _) = connected(&HobConfig {
        // 640 V and 80 A are 2 048 codes.
        noise: ConverterNoise {
            v_v: 3.0 * 640.0 / 2_048.0,
            i_a: 5.0 * 80.0 / 2_048.0,
        },
        anti_alias_hz: 0.0,
        // Idle, a link capacitor would hold the bus at the crest.
        supply: SupplyParts::NONE,
        ..HobConfig::default()
    });
    let found = client.channels().unwrap();
    assert!(
        found.samples > 10_000 && found.slow_samples > 500,
        "{found:?}"
    );
    let near = |x: f64, expected: f64, by: f64| (x - expected).abs() < by;
    let codes = |x: u32| f64::from(x) / 256.0;
    assert!(near(codes(found.v_rms), 3.0, 0.1), "{found:?}");
    assert!(near(codes(found.i_rms), 5.0, 0.15), "{found:?}");
    assert!(near(f64::from(found.v_mean) / 256.0, 0.0, 0.2), "{found:?}");
    assert!(near(f64::from(found.i_mean) / 256.0, 0.0, 0.3), "{found:?}");
    // 230 V of the 400 V that are 2 048 codes; the bus is its rectified sine, 2/π of 325 V of 500 V.
    assert!(
        near(codes(found.mains_rms), 230.0 / 400.0 * 2_048.0, 15.0),
        "{found:?}"
    );
    let bus = 325.27 * std::f64::consts::FRAC_2_PI / 500.0 * 4_096.0;
    assert!(
        near(f64::from(found.bus_mean) / 256.0, bus, 20.0),
        "{found:?}"
    );
    assert!((3_295..=3_305).contains(&found.vdda_mv), "{found:?}");
}

#[test]
fn the_board_is_not_tested_and_not_restarted_while_power_is_asked_for() {
    let (mut client, hob) = connected(&HobConfig::default());
    client.set_power(1_000).unwrap();
    assert_eq!(outcome(client.channels()), Outcome::NotIdle);
    assert_eq!(outcome(client.restart(Program::Firmware)), Outcome::NotIdle);
    wait(&mut client, Duration::from_millis(500));
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_eq!(outcome(client.channels()), Outcome::NotIdle);
    assert_eq!(outcome(client.restart(Program::Firmware)), Outcome::NotIdle);
    assert_eq!(client.status().unwrap().state, State::Heating);
    client.set_power(0).unwrap();
    // The bridge opens at the next zero crossing.
    wait(&mut client, Duration::from_millis(15));
    client.channels().unwrap();
    // No pot: it waits for one with the bridge open, and power is asked for all the same.
    hob.lock()
        .set_pot(ihd_sim::behavioural::PotKind::None)
        .unwrap();
    client.set_power(1_000).unwrap();
    wait(&mut client, Duration::from_millis(500));
    assert_eq!(client.status().unwrap().state, State::WaitingForPot);
    assert_eq!(outcome(client.channels()), Outcome::NotIdle);
}

#[test]
fn a_test_that_is_overtaken_by_power_says_so_and_the_windows_come() {
    let (mut client, _) = connected(&HobConfig::default());
    client.stream(0, 2).unwrap();
    client.channels().unwrap();
    client.set_power(1_000).unwrap();
    let until = client.clock() + Duration::from_secs(2);
    let mut windows = 0;
    while client.clock() < until && windows < 3 {
        if let Some(DeviceEvent::Window(_)) = client.next_event(Duration::from_millis(100)).unwrap()
        {
            windows += 1;
        }
    }
    assert_eq!(windows, 3, "the recorder's slot was not given back");
    assert_eq!(client.counters().windows_rejected_total(), 0);
}

#[test]
fn what_a_simulated_hob_has_not_got_it_does_not_pretend() {
    let (mut client, _) = connected(&HobConfig::default());
    assert_eq!(
        outcome(client.restart(Program::Bootloader)),
        Outcome::Unavailable
    );
    assert_eq!(outcome(client.comparators()), Outcome::Unavailable);
    assert_eq!(outcome(client.clocks()), Outcome::Unavailable);
    assert_eq!(outcome(client.stream_log(true)), Outcome::Unavailable);
}

#[test]
fn after_a_restart_it_is_another_boot_and_the_host_must_say_hello() {
    let (mut client, hob) = connected(&HobConfig::default());
    let before = client.hello().boot_id;
    client.restart(Program::Firmware).unwrap();
    // Until it goes it takes nothing from anybody.
    assert_eq!(outcome(client.set_power(1_000)), Outcome::NotPaired);
    wait(&mut client, Duration::from_millis(200));
    assert_eq!(outcome(client.set_power(1_000)), Outcome::NotPaired);
    let mut again = Client::connect(Box::new(hob.clone())).unwrap();
    assert_ne!(again.hello().boot_id, before);
    assert_eq!(again.hello().reset_reason, 5);
    assert_eq!(again.board().unwrap().starts, 2);
    again.set_power(1_000).unwrap();
    wait(&mut again, Duration::from_millis(500));
    assert_eq!(again.status().unwrap().state, State::Heating);
}

#[test]
fn the_link_carries_what_it_should_in_both_directions() {
    let config = HobConfig {
        link_bytes_per_s: 100e3,
        ..HobConfig::default()
    };
    let (mut client, _) = connected(&config);
    let test = client.test_link(100, 900).unwrap();
    for counts in [&test.to_device, &test.from_device] {
        assert_eq!((counts.frames, counts.bytes), (100, 90_000));
        assert_eq!((counts.bad, counts.lost), (0, 0));
    }
    // 900 bytes are 920 on the wire; the first and the last frame are not between the two moments.
    let rate = 90_000.0 * 920.0 / 900.0 / test.from_device_took.as_secs_f64();
    assert!((90e3..115e3).contains(&rate), "{rate}");
    assert_eq!(outcome(client.test_link(1, 961)), Outcome::OutOfRange);
    // What was asked for before is gone.
    assert_eq!(client.test_link(0, 0).unwrap().from_device.frames, 0);
}

#[test]
fn power_can_be_tried_from_a_bench_supply() {
    let (mut client, _) = connected(&HobConfig {
        bench_supply_v: Some(60.0),
        ..HobConfig::default()
    });
    let idle = client.channels().unwrap();
    let bus_v = f64::from(idle.bus_mean) / 256.0 / 4_096.0 * 500.0;
    assert!((bus_v - 60.0).abs() < 0.5, "{idle:?}");
    let mains_v = f64::from(idle.mains_rms) / 256.0 / 2_048.0 * 400.0;
    assert!((mains_v - 24.0).abs() < 0.5, "{idle:?}");
    client.set_power(1).unwrap();
    client.stream(1, 0).unwrap();
    let until = client.clock() + Duration::from_secs(2);
    let mut most_mw = 0;
    while client.clock() < until {
        if let Some(DeviceEvent::Telemetry(t)) =
            client.next_event(Duration::from_millis(100)).unwrap()
        {
            most_mw = most_mw.max(t.power_mw);
        }
    }
    assert_eq!(client.status().unwrap().state, State::Heating);
    // docs/bring-up.md, section E: 25 W at 60 V in the half-cycles that it switches.
    assert!((20_000..30_000).contains(&most_mw), "{most_mw}");
}
