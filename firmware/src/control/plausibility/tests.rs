use super::*;
use crate::control::bus_ripple::tests::reading;
use crate::sampling::half_cycle::CurrentCrest;
use crate::sense::bus::BusReading;
use crate::sense::demodulator::{AMPERE_PER_UNIT, Phasors};
use ihd_shared::hob::{RESONANCE_CAPACITANCE_NF, WINDING_R_OHM};
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_shared::units::{MicroOhm, PicoHenry};
use std::f64::consts::{FRAC_2_PI, TAU};

/// Half-cycle of a load at a bus of 325 V, by sensors of the given gains behind their anti-alias filters.
pub(super) fn seen(
    f_hz: f64,
    load: (f64, f64),
    v_gain: f64,
    i_gain: f64,
    bus_gain: f64,
) -> HalfCycle {
    let x_c = 1e9 / (TAU * f_hz * f64::from(RESONANCE_CAPACITANCE_NF));
    let bus = BusReading::steady((3_250.0 * bus_gain) as u16);
    half_cycle(f_hz, load, current(f_hz, load, x_c), (v_gain, i_gain), bus)
}

/// V1/Z with V1 real, in ampere: the current of a load in series with a capacitor's reactance.
fn current(f_hz: f64, (r, l_uh): (f64, f64), x_c: f64) -> (f64, f64) {
    let x = TAU * f_hz * l_uh * 1e-6 - x_c;
    let v1 = FRAC_2_PI * 325.0;
    let z2 = r * r + x * x;
    (v1 * r / z2, -v1 * x / z2)
}

fn half_cycle(
    f_hz: f64,
    (r, l_uh): (f64, f64),
    i: (f64, f64),
    (v_gain, i_gain): (f64, f64),
    bus: BusReading,
) -> HalfCycle {
    let x_l = TAU * f_hz * l_uh * 1e-6;
    let v = (i.0 * r - i.1 * x_l, i.0 * x_l + i.1 * r);
    let filter = 1.0 / f64::hypot(1.0, f_hz / f64::from(ANTI_ALIAS_HZ));
    let mantissa = |x: f64, unit: f64| (x / unit * f64::from(1u32 << STATE_BITS)) as i32;
    let complex = |(re, im): (f64, f64), gain: f64, unit: f64| Complex {
        re: mantissa(re * gain * filter, unit),
        im: mantissa(im * gain * filter, unit),
    };
    HalfCycle {
        f_sw_hz: f_hz as u32,
        duration_ns: 10_000_000,
        crest: CurrentCrest {
            r: MicroOhm((r * v_gain / i_gain * 1e6) as i32),
            l: PicoHenry((l_uh * v_gain / i_gain * 1e6) as i32),
            i_ma: (i.0.hypot(i.1) * i_gain * 1e3) as u32,
            bus,
            phasors: Phasors {
                v: complex(v, v_gain, VOLT_PER_UNIT),
                i: complex(i, i_gain, AMPERE_PER_UNIT),
            },
        },
        power_mw: 1_000_000,
        bus_peak_dv: bus.dv,
        ..HalfCycle::default()
    }
}

/// Half-cycle of a load at a link of so many farad that the line recharges evenly: its elastance counts 1/2 − 2/π² in the tank,
/// and its ripple is that of half the coil's current.
fn with_link(f_hz: f64, load: (f64, f64), c_2: f64) -> HalfCycle {
    let omega = TAU * f_hz;
    let x_r = 1e9 / (omega * f64::from(RESONANCE_CAPACITANCE_NF));
    let x_2 = (0.5 - 0.5 * FRAC_2_PI * FRAC_2_PI) / (omega * c_2);
    let i = current(f_hz, load, x_r + x_2);
    // −I/2 · 1/(jωC), at the bus; the phasors have the anti-alias filter's amplitude, but not its phase.
    let ripple = (-i.1 / (2.0 * omega * c_2), i.0 / (2.0 * omega * c_2));
    let lag = (f_hz / f64::from(ANTI_ALIAS_HZ)).atan();
    let phase = ripple.1.atan2(ripple.0) + lag;
    let bus = reading(f_hz, 325.0, (ripple.0.hypot(ripple.1), phase), 1);
    half_cycle(f_hz, load, i, (1.0, 1.0), bus)
}

/// Within 1 %, of which the ripple's reading takes half, from the largest link down to one that is less than C_r.
#[test]
fn the_balance_holds_whatever_the_link() {
    for load in [POT, SMALL, (2.2, 33.0)] {
        for f_hz in [45e3, 60e3, 79e3] {
            for c_2 in [1e-6, 2.2e-6, 4.7e-6, 10e-6] {
                let ppm = BridgeBalance::from_half_cycle(&with_link(f_hz, load, c_2)).ppm();
                assert!(
                    (ppm - 1_000_000).abs() < 10_000,
                    "{load:?} {f_hz} {c_2}: {ppm}"
                );
            }
        }
    }
}

pub(super) const POT: (f64, f64) = (3.6, 24.0);
pub(super) const SMALL: (f64, f64) = (1.0, 45.0);
/// Nothing but the coil.
pub(super) const BARE: (f64, f64) = (WINDING_R_OHM, BARE_COIL_NH as f64 * 1e-3);

fn fault_of(summary: HalfCycle) -> Option<Fault> {
    let mut plausibility = Plausibility::default();
    (0..10).find_map(|_| plausibility.on_half_cycle(&summary))
}

fn fault_of_probe(summary: HalfCycle) -> Option<Fault> {
    let mut plausibility = Plausibility::default();
    (0..4).find_map(|_| plausibility.on_pot_probe(&summary))
}

#[test]
fn honest_sensors_pass_within_their_tolerances() {
    for load in [POT, SMALL, BARE] {
        for f_hz in [38e3, 47e3, 60e3, 79e3] {
            for (v, i, bus) in [(1.0, 1.0, 1.0), (1.01, 0.99, 0.99), (0.99, 1.01, 1.01)] {
                let summary = seen(f_hz, load, v, i, bus);
                assert_eq!(fault_of(summary), None, "{f_hz} {load:?}");
                assert_eq!(fault_of_probe(summary), None, "{f_hz} {load:?}");
            }
        }
    }
}

/// C_r of ±5 % and gains of ±2 % at once, where they add up most; C_r of four fifths is no such board.
#[test]
fn a_board_of_honest_parts_passes_whatever_their_sum() {
    // |V + I·(−jX_C)| with X_C of a C_r of another size, by the bus that gives it.
    let with_capacitor = |f_hz: f64, (r, l_uh): (f64, f64), share: f64, gain: f64| {
        let summary = seen(f_hz, (r, l_uh), 1.0, gain, 1.0);
        let x_c = 1e9 / (TAU * f_hz * f64::from(RESONANCE_CAPACITANCE_NF));
        let x_l = TAU * f_hz * l_uh * 1e-6;
        let real = r.hypot(x_l - x_c / share) / r.hypot(x_l - x_c);
        let bus_dv = f64::from(summary.crest.bus.dv) * real * gain;
        let mut summary = summary;
        summary.crest.bus = BusReading::steady(bus_dv as u16);
        fault_of(summary)
    };
    for (f_hz, load) in [(38e3, POT), (47e3, POT), (60e3, POT), (45e3, (2.2, 33.0))] {
        for (share, gain) in [(0.95, 0.98), (1.05, 1.02), (0.9, 1.0), (1.0, 1.0)] {
            let found = with_capacitor(f_hz, load, share, gain);
            assert_eq!(found, None, "{f_hz} {load:?} {share} {gain}");
        }
    }
    for f_hz in [38e3, 47e3] {
        let found = with_capacitor(f_hz, POT, 0.8, 1.0);
        assert_eq!(found, Some(Fault::BRIDGE_BALANCE), "{f_hz}");
    }
}

#[test]
fn a_wrong_gain_is_seen_within_four_half_cycles() {
    for (v, i, bus) in [
        (0.8, 1.0, 1.0),
        (1.25, 1.0, 1.0),
        (1.0, 0.8, 1.0),
        (1.0, 1.25, 1.0),
        (1.0, 1.0, 1.25),
        (1.0, 1.0, 0.5),
    ] {
        for f_hz in [38e3, 47e3] {
            let summary = seen(f_hz, POT, v, i, bus);
            assert_eq!(
                fault_of(summary),
                Some(Fault::BRIDGE_BALANCE),
                "{v} {i} {bus}"
            );
        }
    }
}

/// Each of them makes the hob heat with 5 % too much, or its protection act late.
#[test]
fn the_bare_coil_shows_a_current_that_reads_too_little_and_a_voltage_that_does_not_fit_the_bus() {
    for (v, i, bus) in [
        (1.0, 0.95, 1.0),
        (1.0, 0.9, 1.0),
        (0.95, 1.0, 1.0),
        (1.05, 1.0, 1.0),
        (1.0, 1.0, 0.95),
        (1.0, 1.0, 1.05),
    ] {
        let wrong = |load| fault_of_probe(seen(79_911.0, load, v, i, bus));
        assert_eq!(wrong(BARE), Some(Fault::BRIDGE_BALANCE), "{v} {i} {bus}");
        // A load hides so little.
        assert_eq!(wrong(SMALL), None, "{v} {i} {bus}");
    }
    for (v, bus) in [(0.8, 1.0), (1.0, 1.25)] {
        let wrong = fault_of_probe(seen(79_911.0, POT, v, 1.0, bus));
        assert_eq!(wrong, Some(Fault::BRIDGE_BALANCE), "{v} {bus}");
    }
    // A capacitor of four fifths moves the balance by 2 % there.
    let mut aged = seen(79_911.0, BARE, 1.0, 1.0, 1.0);
    aged.crest.bus = BusReading::steady((3_250.0 * (1.0 - 0.25 * 0.078)) as u16);
    assert_eq!(fault_of_probe(aged), None);
}

/// docs/control.md: a current that reads four fifths at the probe frequency.
#[test]
fn what_the_balance_cannot_see_the_dc_link_does() {
    let mut summary = seen(79e3, (5.9, 22.0), 1.0, 0.8, 1.0);
    assert_eq!(fault_of(summary), None);
    summary.dc_link_mw = Some(1_250_000);
    assert_eq!(fault_of(summary), Some(Fault::POWER_BALANCE));
    summary.dc_link_mw = Some(1_050_000);
    assert_eq!(fault_of(summary), None);
}

#[test]
fn offsets_and_missing_current_have_names() {
    let good = seen(47e3, POT, 1.0, 1.0, 1.0);
    let with = |change: fn(&mut HalfCycle)| {
        let mut summary = good;
        change(&mut summary);
        fault_of(summary)
    };
    assert_eq!(
        with(|s| s.channels.i_offset_ma = -5_000),
        Some(Fault::SENSOR_OFFSET)
    );
    assert_eq!(
        with(|s| s.channels.v_offset_dv = 400),
        Some(Fault::SENSOR_OFFSET)
    );
    assert_eq!(
        with(|s| s.channels.i_gap = true),
        Some(Fault::SENSOR_OFFSET)
    );
    let without_current = |s: &mut HalfCycle| (s.channels.i_gap, s.crest.i_ma) = (true, 5_000);
    assert_eq!(with(without_current), None);
    assert_eq!(with(|s| s.crest.i_ma = 200), Some(Fault::NO_COIL_CURRENT));
    assert_eq!(with(|s| s.bus_peak_dv = 0), Some(Fault::BUS_RANGE));
}

#[test]
fn the_mains_must_be_regular_but_may_stumble() {
    let mut plausibility = Plausibility::default();
    let mut after = |duration_ns: u32, bus_at_crossing_dv: u16| {
        plausibility.on_half_cycle(&HalfCycle {
            duration_ns,
            bus_at_crossing_dv,
            ..seen(47e3, POT, 1.0, 1.0, 1.0)
        })
    };
    for _ in 0..4 {
        // A dropout, now and then.
        assert_eq!(after(29_000_000, 0), None);
        for _ in 0..8 {
            assert_eq!(after(10_000_000, 40), None);
        }
    }
    // Every other crossing missing.
    assert_eq!([after(20_000_000, 0), after(20_000_000, 0)], [None; 2]);
    assert_eq!(after(20_000_000, 0), Some(Fault::MAINS_IRREGULAR));
    for _ in 0..8 {
        after(10_000_000, 40);
    }
    // A millisecond late: sin 18° of the peak.
    let late: [_; 3] = core::array::from_fn(|_| after(10_000_000, 1_004));
    assert_eq!(late, [None, None, Some(Fault::MAINS_IRREGULAR)]);
}

/// docs/bring-up.md, section F, read 0.4 % high (docs/board.md, "Scales"). 25 W at 60 V: the power rises with the voltage's square.
#[test]
fn a_bench_supply_that_holds_the_bus_is_no_crossing_out_of_place() {
    for bus_v in [60u16, 80, 120] {
        let bus_dv = (10.04 * f64::from(bus_v)) as u16;
        let gain = f64::from(bus_v) / 325.0;
        let summary = HalfCycle {
            power_mw: 7 * u32::from(bus_v).pow(2),
            bus_peak_dv: bus_dv,
            bus_at_crossing_dv: bus_dv,
            ..seen(79.9e3, POT, gain, gain, gain)
        };
        assert_eq!(fault_of(summary), None, "{bus_v}");
    }
}

/// 10 µF at 325 V and 50 Hz: tan θ = ωRC = 0.42 with R = 134 ohm, which takes 394 W.
#[test]
fn with_a_load_too_light_for_the_link_the_bus_at_the_crossing_says_nothing() {
    for (power_mw, fault) in [(380_000, None), (410_000, Some(Fault::MAINS_IRREGULAR))] {
        let summary = HalfCycle {
            power_mw,
            bus_at_crossing_dv: 2_000,
            ..seen(47e3, POT, 1.0, 1.0, 1.0)
        };
        assert_eq!(fault_of(summary), fault, "{power_mw}");
    }
}
