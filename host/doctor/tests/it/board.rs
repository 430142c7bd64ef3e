//! The self-test with the bridge off.

use ihd_doctor::{CheckResult, board};
use ihd_shared::wire::messages::State;
use ihd_sim::adc::ConverterNoise;
use ihd_sim::hob::HobConfig;
use ihd_sim::injection::{FaultChannel, Injection, InjectionKind};

use crate::desk::{complete, connected, failed, find_check};

#[test]
fn a_healthy_hob_fails_nothing_and_heats_no_sooner() {
    let (mut client, hob) = connected(&HobConfig::default());
    let found = board::examine(&mut client);
    complete(&found.checks, &board::NAMES);
    assert_eq!(failed(&found.checks), [] as [&str; 0]);
    for name in [
        "idle",
        "channels",
        "noise",
        "latency",
        "link_to_device",
        "link_from_device",
    ] {
        assert_eq!(
            find_check(&found.checks, name).verdict,
            CheckResult::Pass,
            "{name}"
        );
    }
    assert!(found.lost.is_none() && found.facts.is_ok());
    drop(client);
    assert_eq!(hob.lock().pot(), HobConfig::default().pot);
}

#[test]
fn a_hob_that_heats_is_asked_for_no_test_and_goes_on() {
    let (mut client, _hob) = connected(&HobConfig::default());
    client.set_power(1_000).unwrap();
    while client.status().unwrap().state != State::Heating {
        client
            .next_event(std::time::Duration::from_millis(10))
            .unwrap();
    }
    let found = board::examine(&mut client);
    complete(&found.checks, &board::NAMES);
    assert_eq!(failed(&found.checks), ["idle"]);
    for name in ["channels", "comparators", "clocks", "link_to_device"] {
        let check = find_check(&found.checks, name);
        assert_eq!(
            (check.verdict, check.finding.as_str()),
            (CheckResult::NotTested, board::HEATS)
        );
    }
    let status = client.status().unwrap();
    assert_eq!((status.state, status.asked_w), (State::Heating, 1_000));
}

/// 12 codes of 312.7 mV are 3.75 V; of 39.1 mA 0.47 A (docs/bring-up.md, D1).
#[test]
fn an_offset_is_found_from_twelve_codes_on() {
    for (kind, value, fails) in [
        (InjectionKind::VoltageOffset, 3.4, false),
        (InjectionKind::VoltageOffset, 4.1, true),
        (InjectionKind::VoltageOffset, -4.1, true),
        (InjectionKind::CurrentOffset, 0.43, false),
        (InjectionKind::CurrentOffset, -0.51, true),
    ] {
        let (mut client, hob) = connected(&HobConfig::default());
        hob.lock().inject(|injections| {
            injections.start(Injection {
                kind,
                value,
                channel: FaultChannel::Current,
            });
        });
        let found = board::examine(&mut client);
        let expected: &[&str] = if fails { &["channels"] } else { &[] };
        assert_eq!(failed(&found.checks), expected, "{kind:?} {value}");
    }
}

#[test]
fn a_noisy_channel_and_a_dead_one_fail() {
    let code_a = 80.0 / 2_048.0;
    for (codes, fails) in [(3.0, false), (5.0, true)] {
        let config = HobConfig {
            noise: ConverterNoise {
                v_v: 0.16,
                i_a: codes * code_a,
            },
            anti_alias_hz: 0.0,
            ..HobConfig::default()
        };
        let (mut client, _hob) = connected(&config);
        let found = board::examine(&mut client);
        let expected: &[&str] = if fails { &["noise"] } else { &[] };
        assert_eq!(failed(&found.checks), expected, "{codes} codes");
    }
    let (mut client, hob) = connected(&HobConfig::default());
    hob.lock().inject(|injections| {
        injections.start(Injection {
            kind: InjectionKind::VoltageStuck,
            value: 0.0,
            channel: FaultChannel::Voltage,
        });
    });
    let found = board::examine(&mut client);
    assert!(
        failed(&found.checks).contains(&"noise"),
        "{:#?}",
        found.checks
    );
}

#[test]
fn a_hob_without_mains_is_told_what_its_bench_lacks() {
    let config = HobConfig {
        mains_v: 0.0,
        ..HobConfig::default()
    };
    let (mut client, _hob) = connected(&config);
    // Three half-cycles without a crossing.
    let until = client.clock() + std::time::Duration::from_millis(200);
    while client.clock() < until {
        client
            .next_event(std::time::Duration::from_millis(20))
            .unwrap();
    }
    let found = board::examine(&mut client);
    let fault = find_check(&found.checks, "fault");
    assert_eq!(fault.verdict, CheckResult::NotTested, "{fault:?}");
    assert!(fault.remedy.as_ref().unwrap().contains("24 V~"));
    assert_eq!(failed(&found.checks), [] as [&str; 0]);
}
