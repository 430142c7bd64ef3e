use super::*;
use crate::estimate::tank::resonant_inductance;
use crate::sense::correlation::correlate;
use ihd_shared::hob::TANK_CAPACITANCE_PF;
use ihd_shared::sampling::VOLT_PER_CODE;
use std::f64::consts::TAU;

/// Coil voltage and current of a series R, L that carries a sine of `i_a`, its zero crossing
/// `lag` of a period after the upper switch's turn-on.
fn block(f_hz: f64, r_ohm: f64, l_h: f64, i_a: f64, lag: f64) -> [Pair; ADC_LOCK_P] {
    core::array::from_fn(|k| {
        let turn = (3 * k) as f64 / 61.0 - lag;
        let (i, di) = (i_a * (TAU * turn).sin(), i_a * (TAU * turn).cos());
        let v = r_ohm * i + TAU * f_hz * l_h * di;
        Pair {
            v: (v / VOLT_PER_CODE).round() as i16,
            i: (i / AMPERE_PER_CODE).round() as i16,
        }
    })
}

/// Blocks of one kind, from a new frequency on.
struct Run {
    soft: SoftLimits,
    f_hz: u32,
}

impl Run {
    fn new(f_hz: u32) -> Self {
        let mut soft = SoftLimits::default();
        soft.set_frequency(f_hz, resonant_inductance(f_hz));
        for _ in 0..SOFT_HOLD_BLOCKS {
            let quiet = [Pair::default(); ADC_LOCK_P];
            soft.check(&correlate(&quiet), &quiet, 0);
        }
        Self { soft, f_hz }
    }

    /// The limit that acts within a quarter of a second, and the block that it acts in, from 1.
    fn acts(&mut self, pairs: &[Pair; ADC_LOCK_P], bus_dv: u16) -> Option<(Limit, u32)> {
        let sums = correlate(pairs);
        (1..=self.f_hz / 12).find_map(|block| {
            let limit = self.soft.check(&sums, pairs, bus_dv).limit;
            (limit != Limit::None).then_some((limit, block))
        })
    }
}

fn acts(f_hz: u32, pairs: &[Pair; ADC_LOCK_P], bus_dv: u16) -> Option<(Limit, u32)> {
    Run::new(f_hz).acts(pairs, bus_dv)
}

/// L whose reactance is so much, in percent of its own, above the capacitor's.
fn l_h(f_hz: f64, percent: f64) -> f64 {
    let x_c = 1e12 / (TAU * f_hz * f64::from(TANK_CAPACITANCE_PF));
    x_c / (1.0 - percent / 100.0) / (TAU * f_hz)
}

/// 12 % of the reactance are missing after six blocks at 2 % in place of 4, after three in resonance, after one at −10 %.
#[test]
fn resonance_is_seen_at_its_margin() {
    for f_hz in [36e3, 50e3, 75e3] {
        for (percent, blocks) in [
            (6.0, None),
            (2.0, Some(6)),
            (0.0, Some(3)),
            (-10.0, Some(1)),
        ] {
            for (r, i) in [(0.3, 30.0), (4.0, 40.0), (4.0, 17.0)] {
                let pairs = block(f_hz, r, l_h(f_hz, percent), i, 0.2);
                let expected = blocks.map(|blocks| (Limit::Resonance, blocks));
                let seen = acts(f_hz as u32, &pairs, 0);
                assert_eq!(seen, expected, "{f_hz} {percent} {r} {i}");
            }
        }
    }
}

/// A small current takes longer, by its square: a half-cycle's 5 A in resonance 30 blocks, 1.8 ms at 50 kHz.
#[test]
fn resonance_is_checked_from_3_a_on() {
    for (i_a, blocks) in [(2.9, 0..1), (3.1, 75..90), (5.0, 28..33), (8.0, 11..14)] {
        let pairs = block(50e3, 4.0, l_h(50e3, 0.0), i_a, 0.2);
        let seen = acts(50_000, &pairs, 0).map_or(0, |(_, block)| block);
        assert!(blocks.contains(&seen), "{i_a}: {seen}");
    }
}

/// Voltage that a node of 15 nF lacks of the other rail a microsecond after the turn-off, with diodes at both rails and the coil's
/// current falling evenly.
fn missing_v(bus_v: f64, turn_off_a: f64, fall_a_per_us: f64) -> f64 {
    let steps = 2_000;
    let mut node_v = bus_v;
    for step in 0..steps {
        let i_a = turn_off_a - fall_a_per_us * (f64::from(step) + 0.5) / f64::from(steps);
        node_v = (node_v - i_a / 15e-3 / f64::from(steps)).clamp(0.0, bus_v);
    }
    node_v
}

/// 58 A in phase at 40 kHz fall by 14.6 A in a microsecond: what moves the charge at a constant current, 3.8 A at 255 V, leaves all of it.
#[test]
fn the_need_is_the_least_current_that_moves_the_node() {
    for bus_v in [60.0, 180.0, 255.0, 375.0] {
        for (f_hz, in_phase_a) in [(40e3, 0.0), (34e3, 5.0), (40e3, 58.0), (80e3, 30.0)] {
            let fall_a = TAU * f_hz * in_phase_a * 1e-6;
            let fall_ma = half_dead_time_fall_ma(f_hz as u32, (in_phase_a * 1e3) as i64);
            assert!(
                (f64::from(fall_ma) - 500.0 * fall_a).abs() < 5.0,
                "{fall_ma}"
            );
            let need_a = f64::from(turn_off_need_ma((bus_v * 10.0) as u16, fall_ma)) * 1e-3;
            let missing = |share: f64| missing_v(bus_v, share * need_a, fall_a);
            assert!(missing(1.02) < 0.5, "{bus_v} {f_hz} {in_phase_a}: {need_a}");
            assert!(missing(0.93) > 1.0, "{bus_v} {f_hz} {in_phase_a}: {need_a}");
        }
    }
    assert!(missing_v(255.0, 1.5 * 3.8, 14.6) > 200.0);
}

/// A current near its zero crossing at the turn-off, as near resonance: 58 A at 40 kHz of which 8 A are left at 255 V bring the node back to
/// where it was; 20 A do not.
#[test]
fn a_current_that_falls_through_zero_is_too_little() {
    let seen = |turn_off_a: f64| {
        let lag = (turn_off_a / 58.0).asin() / TAU;
        acts(40_000, &block(40e3, 2.8, 18.8e-6, 58.0, lag), 2_550)
    };
    assert!(missing_v(255.0, 8.0, TAU * 40e3 * 57e-6) > 50.0);
    let (limit, block) = seen(8.0).expect("too little");
    assert_eq!(limit, Limit::SoftSwitching);
    assert!(block <= 4, "{block}");
    assert_eq!(seen(20.0), None);
}

/// 15 nF at 300 V are 4.5 µC, which 4.5 A move in a microsecond; 15 % more are wanted, 5.2 A. At the crest nothing falls.
#[test]
fn the_turn_off_current_must_move_the_nodes_charge() {
    assert_eq!(turn_off_need_ma(3_000, 0), 4_500);
    // Lag of a quarter: the turn-off is at the crest. 32 A are missing in so many blocks.
    let seen = |i_a| acts(60_000, &block(60e3, 1.0, 60e-6, i_a, 0.25), 3_000);
    assert_eq!(seen(6.0), None);
    for (i_a, blocks) in [(4.8, 70..100), (3.0, 13..17), (0.0, 6..8)] {
        let (limit, block) = seen(i_a).expect("too little");
        assert_eq!(limit, Limit::SoftSwitching);
        assert!(blocks.contains(&block), "{i_a} A: {block}");
    }
    let turn_off_ma = |i_a| {
        let pairs = block(60e3, 1.0, 60e-6, i_a, 0.25);
        let checked = Run::new(60_000)
            .soft
            .check(&correlate(&pairs), &pairs, 3_000);
        checked.turn_off_ma.expect("300 V")
    };
    assert!((5_800..=6_050).contains(&turn_off_ma(6.0)));
    // A current that leads turns off the wrong way: 20 A at its crest, 11 A then.
    let leading = block(60e3, 1.0, 60e-6, 20.0, 0.9);
    let seen = acts(60_000, &leading, 3_000).expect("the wrong way");
    assert_eq!(seen.0, Limit::SoftSwitching);
    assert!(seen.1 <= 2, "{seen:?}");
    assert_eq!(acts(60_000, &block(60e3, 1.0, 60e-6, 4.0, 0.25), 300), None);
}

/// A current with an offset turns one of the switches off late, and its sum alone acts.
#[test]
fn each_switch_has_a_sum_of_its_own() {
    for sign in [1.0, -1.0] {
        let mut pairs = block(60e3, 1.0, 60e-6, 6.0, 0.25);
        for pair in &mut pairs {
            pair.i += (sign * 4.0 / AMPERE_PER_CODE) as i16;
        }
        let (limit, block) = acts(60_000, &pairs, 3_000).expect("2 A");
        assert_eq!(limit, Limit::SoftSwitching);
        assert!((9..=11).contains(&block), "{sign}: {block}");
    }
}

#[test]
fn a_large_crest_acts_before_it_trips() {
    let seen = |i_a, l_h| acts(60_000, &block(60e3, 1.0, l_h, i_a, 0.2), 0);
    assert_eq!(seen(72.0, 12e-6), None);
    assert_eq!(seen(74.0, 12e-6), Some((Limit::Current, 1)));
    assert_eq!(seen(40.0, 40e-6), Some((Limit::CoilVoltage, 1)));
}

/// White noise of 20 dB of the rating's rms, 2.8 A and 18 V, about a load that is sound: nothing acts in ten seconds. The third
/// harmonic is left out.
#[test]
fn noise_about_a_sound_load_adds_up_to_nothing() {
    let mut state = 1_u64;
    // A sum of twelve uniform numbers has a variance of 1.
    let mut normal = move || {
        (0..12).fold(-6.0, |sum, _| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            sum + (state >> 40) as f64 / f64::from(1 << 24)
        })
    };
    let mut run = Run::new(50_000);
    // 45 A at the crest of 325 V, 30 % above resonance, lagging by 50 degrees.
    for half_cycle in 0..1_000 {
        for turn in 0..167 {
            let share = (std::f64::consts::PI * f64::from(turn) / 167.0).sin();
            let mut pairs = block(50e3, 3.0, l_h(50e3, 30.0), 45.0 * share, 50.0 / 360.0);
            for pair in &mut pairs {
                pair.i += (2.77 * normal() / AMPERE_PER_CODE).round() as i16;
                pair.v += (17.9 * normal() / VOLT_PER_CODE).round() as i16;
            }
            let bus_dv = (3_250.0 * share) as u16;
            let seen = run.soft.check(&correlate(&pairs), &pairs, bus_dv);
            assert_eq!(seen.limit, Limit::None, "{half_cycle} {turn}");
        }
    }
}

#[test]
fn a_new_frequency_is_given_time() {
    let mut soft = SoftLimits::default();
    soft.set_frequency(60_000, resonant_inductance(60_000));
    let pairs = block(60e3, 1.0, 12e-6, 74.0, 0.2);
    for _ in 0..SOFT_HOLD_BLOCKS {
        assert_eq!(soft.check(&correlate(&pairs), &pairs, 0).limit, Limit::None);
    }
    assert_eq!(
        soft.check(&correlate(&pairs), &pairs, 0).limit,
        Limit::Current
    );
}
