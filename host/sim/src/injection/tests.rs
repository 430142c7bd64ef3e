use super::*;

const PAIR: Pair = Pair { v: 800, i: -512 };

fn after(kind: InjectionKind, value: f64, channel: FaultChannel) -> Pair {
    let mut injections = Injections::default();
    injections.start(Injection {
        kind,
        value,
        channel,
    });
    let mut first = [PAIR; ADC_LOCK_P];
    first[0] = Pair { v: 5, i: 6 };
    injections.on_pairs(&mut first);
    let mut pairs = [PAIR; ADC_LOCK_P];
    injections.on_pairs(&mut pairs);
    assert!(pairs[1..].iter().all(|p| *p == pairs[1]));
    pairs[1]
}

#[test]
fn each_kind_does_to_the_codes_what_it_says() {
    use InjectionKind as K;
    let current = |kind, value| after(kind, value, FaultChannel::Current);
    assert_eq!(current(K::CurrentGain, 0.8), Pair { v: 800, i: -410 });
    assert_eq!(current(K::VoltageGain, 1.25), Pair { v: 1000, i: -512 });
    assert_eq!(current(K::VoltageGain, 5.0).v, CODE_MAX);
    let amperes = 100.0 * AMPERE_PER_CODE;
    assert_eq!(current(K::CurrentOffset, amperes), Pair { v: 800, i: -412 });
    let volts = -100.0 * VOLT_PER_CODE;
    assert_eq!(current(K::VoltageOffset, volts), Pair { v: 700, i: -512 });
    assert_eq!(current(K::CurrentStuck, 0.0), Pair { v: 800, i: 6 });
    assert_eq!(current(K::VoltageStuck, 0.0), Pair { v: 5, i: -512 });
    assert_eq!(current(K::ChannelsSwapped, 0.0), Pair { v: -512, i: 800 });
    // −512 + 2048 = 0b110_0000_0000: bit 3 is new, bit 10 is there.
    assert_eq!(current(K::AdcBitStuck, 3.0), Pair { v: 800, i: -504 });
    assert_eq!(current(K::AdcBitStuck, 10.0), PAIR);
    assert_eq!(after(K::AdcBitStuck, 0.0, FaultChannel::Voltage).v, 801);
    assert_eq!(current(K::ComparatorDead, 0.0), PAIR);
    assert_eq!(current(K::ResonanceCapacitance, 0.8), PAIR);
}

fn one(kind: InjectionKind, value: f64) -> Injections {
    let mut injections = Injections::default();
    injections.start(Injection {
        kind,
        value,
        channel: FaultChannel::Current,
    });
    injections
}

#[test]
fn frozen_samples_repeat_the_first_block_and_end_with_their_number() {
    let mut injections = Injections::default();
    let number = injections.start(Injection {
        kind: InjectionKind::FrozenSamples,
        value: 0.0,
        channel: FaultChannel::Current,
    });
    let mut blocks = [[Pair { v: 1, i: 2 }; ADC_LOCK_P], [PAIR; ADC_LOCK_P]];
    blocks.iter_mut().for_each(|b| injections.on_pairs(b));
    assert_eq!(blocks[1], blocks[0]);
    injections.end(number);
    let mut block = [PAIR; ADC_LOCK_P];
    injections.on_pairs(&mut block);
    assert_eq!(block, [PAIR; ADC_LOCK_P]);
}

#[test]
fn every_second_block_and_every_third_crossing_is_lost() {
    let mut blocks = one(InjectionKind::LostBlocks, 2.0);
    let lost: Vec<bool> = (0..4).map(|_| blocks.on_block()).collect();
    assert_eq!(lost, [false, true, false, true]);
    let mut crossings = one(InjectionKind::LostCrossings, 3.0);
    let seen: Vec<Option<u8>> = (0..6)
        .map(|_| crossings.on_crossing(Some(7), 0.0, 1e-4))
        .collect();
    assert_eq!(seen, [Some(7), Some(7), None, Some(7), Some(7), None]);
    assert_eq!(crossings.on_crossing(None, 0.0, 1e-4), None);
}

#[test]
fn a_late_crossing_comes_in_the_block_in_which_it_is_due() {
    let mut late = one(InjectionKind::LateCrossings, 0.2505);
    let block_s = 61e-6;
    let seen: Vec<Option<u8>> = (0..6)
        .map(|n| {
            let at = (n == 0).then_some(10);
            late.on_crossing(at, f64::from(n) * block_s, f64::from(n + 1) * block_s)
        })
        .collect();
    // 10 µs + 250.5 µs are 16.5 µs into the fifth block of 61 µs.
    assert_eq!(seen, [None, None, None, None, Some(17), None]);
}

#[test]
fn the_bus_is_scaled() {
    assert_eq!(one(InjectionKind::BusScale, 0.5).on_bus(2600), 1300);
    assert_eq!(one(InjectionKind::BusScale, 3.0).on_bus(2600), 4095);
    assert_eq!(Injections::default().on_bus(2600), 2600);
}

#[test]
fn the_sensor_that_the_comparators_see_is_that_of_the_codes() {
    let mut injections = one(InjectionKind::CurrentGain, 0.5);
    injections.start(Injection {
        kind: InjectionKind::CurrentOffset,
        value: 100.0 * AMPERE_PER_CODE,
        channel: FaultChannel::Current,
    });
    let mut pairs = [PAIR];
    injections.on_pairs(&mut pairs);
    let seen_a = injections
        .current_sensor()
        .output_a(f64::from(PAIR.i) * AMPERE_PER_CODE);
    assert_eq!((seen_a / AMPERE_PER_CODE).round() as i16, pairs[0].i);
    assert_eq!(pairs[0].i, -156);
}
