use super::search::trim_hz;
use super::*;
use crate::control::bus_ripple::tests::reading;
use crate::limits::PLANNED_BUS_DV;
use crate::sampling::half_cycle::CurrentCrest;
use ihd_shared::lookup::prior::prior;
use ihd_shared::units::{MicroOhm, PicoHenry};

fn crest(r: MicroOhm, l: PicoHenry, i_ma: u32) -> CurrentCrest {
    CurrentCrest {
        r,
        l,
        i_ma,
        ..CurrentCrest::default()
    }
}

/// A plant whose power is the prediction times a factor the control does not know.
fn settle(asked_w: u64, plant: f64) -> (u32, f64) {
    settle_on(&prior(), &prior(), asked_w, plant)
}

/// All of a search at once, and its steps.
fn search(
    control: &mut PowerControl,
    summary: &HalfCycle,
    asked_mw: u64,
    lookup: &RlLookup,
) -> (u32, u32) {
    control.begin(summary, asked_mw);
    for step in 1..=STEPS_PER_SEARCH {
        if let Some(f_sw_hz) = control.advance(lookup) {
            assert!(!control.is_searching());
            return (f_sw_hz, step);
        }
    }
    panic!("{asked_mw} mW from {summary:?} takes more steps");
}

fn settle_on(load: &RlLookup, lookup: &RlLookup, asked_w: u64, plant: f64) -> (u32, f64) {
    let mut control = PowerControl::default();
    let mut f = pwm::MAX_HZ;
    let mut power = 0.0;
    for _ in 0..60 {
        power = predict(load, f, 3_253).map_or(0.0, |p| p.power_mw as f64 * plant);
        let (r, l) = load.interpolate(f, 30_000);
        let summary = HalfCycle {
            f_sw_hz: f,
            power_mw: power as u32,
            bus_peak_dv: 3_253,
            crest: crest(r, l, 30_000),
            ..HalfCycle::default()
        };
        let (next, _) = search(&mut control, &summary, asked_w * 1_000, lookup);
        assert_eq!(next, pwm::nearest_hz(next));
        // Half of the grid's widest step beyond.
        assert!(
            next + STEP_DOWN_HZ + 144 >= f && next <= f + STEP_UP_HZ + 144,
            "{f} -> {next}"
        );
        f = next;
    }
    (f, power / 1e3)
}

#[test]
fn reaches_the_asked_power_whatever_the_lookup_misses() {
    // 0.7 of what 68 A and the margin allow are 1,870 W.
    for asked in [700, 1_000, 1_500, 1_800] {
        for plant in [0.7, 1.0, 1.3] {
            let (_, power) = settle(asked, plant);
            let error = (power / asked as f64 - 1.0).abs();
            assert!(error <= 0.02, "{asked} W, plant {plant}: {power}");
        }
    }
}

#[test]
fn more_than_the_load_can_take_stops_at_the_margin() {
    let (f, power) = settle(2_500, 0.5);
    assert!(power < 2_500.0);
    assert!(
        predict(&prior(), f, 3_253).is_some(),
        "it must stay above resonance"
    );
}

/// Taught up to 45 A with a load of less R and L than the prior, which the cells above keep: at
/// the seam the prediction falls with falling frequency.
#[test]
fn a_half_taught_lookup_does_not_hold_the_frequency() {
    let mut lookup = prior();
    let taught = |cell: u16| (f32::from(cell) * 0.8) as u16;
    for row in lookup.r.iter_mut().chain(&mut lookup.l) {
        row[..13].iter_mut().for_each(|cell| *cell = taught(*cell));
    }
    // The plant is the load that the lookup was taught with, at every current.
    let mut plant = prior();
    for row in plant.r.iter_mut().chain(&mut plant.l) {
        row.iter_mut().for_each(|cell| *cell = taught(*cell));
    }
    let power = settle_on(&plant, &lookup, 1_900, 1.0).1;
    assert!((power / 1_900.0 - 1.0).abs() <= 0.02, "{power}");
}

#[test]
fn a_load_near_resonance_sends_the_frequency_up() {
    let mut control = PowerControl::default();
    let summary = HalfCycle {
        f_sw_hz: 40_000,
        power_mw: 100_000,
        bus_peak_dv: 3_253,
        crest: crest(MicroOhm(3_000_000), PicoHenry(15_000_000), 20_000),
        ..HalfCycle::default()
    };
    let next = search(&mut control, &summary, 2_000_000, &prior());
    // 8 kHz away from resonance, and further still: saturated to 2.75 ohm and 12.1 µH, this load takes 70 A at 49 kHz, which fall by 22 A in
    // the dead time: 1.5 times that flow at the turn-off from 52 kHz on.
    assert!((48_000..54_000).contains(&next.0), "{next:?}");
}

/// The oracle: bisection over the whole range at once, then the measurement's bounds.
fn whole_range(summary: &HalfCycle, asked_mw: u64, lookup: &RlLookup, factor_q10: u64) -> u32 {
    let (mut low, mut high) = (F_SW_MIN_HZ, F_SW_MAX_HZ);
    while high - low > 1 {
        let middle = low.midpoint(high);
        match predict(lookup, middle, summary.bus_peak_dv) {
            Some(p) if (p.power_mw * factor_q10) >> 10 <= asked_mw => high = middle,
            _ => low = middle,
        }
    }
    let now = summary.f_sw_hz;
    let error = i64::from(summary.power_mw) - asked_mw as i64;
    let trim = trim_hz(now, error.unsigned_abs(), asked_mw).min(STEP_UP_HZ);
    if error > 0 {
        high.clamp(now + trim, now + (3 * trim).min(STEP_UP_HZ))
    } else {
        high.clamp(
            now - (3 * trim).min(STEP_DOWN_HZ),
            now - trim.min(STEP_DOWN_HZ),
        )
    }
    .clamp(F_SW_MIN_HZ, F_SW_MAX_HZ)
}

/// In its steps, which are few, the search finds what it would find at once.
#[test]
fn a_search_in_steps_finds_the_frequency_of_one_over_the_whole_range() {
    let lookup = prior();
    let taught = observed_everywhere();
    let mut most_steps = 0;
    for asked_mw in (300_000..=2_500_000).step_by(170_000) {
        for f in (40_000..F_SW_MAX_HZ).step_by(1_777) {
            let f_sw_hz = pwm::nearest_hz(f);
            for plant_percent in [40, 80, 130, 230] {
                let Some(predicted) = predict(&lookup, f_sw_hz, 3_253) else {
                    continue;
                };
                let power_mw = predicted.power_mw * plant_percent / 100;
                if power_mw.abs_diff(asked_mw) * 100 <= asked_mw * 2 {
                    continue;
                }
                let (r, l) = lookup.interpolate(f_sw_hz, 30_000);
                let summary = HalfCycle {
                    f_sw_hz,
                    power_mw: power_mw as u32,
                    bus_peak_dv: 3_253,
                    crest: crest(r, l, 30_000),
                    ..HalfCycle::default()
                };
                let mut control = PowerControl::default();
                let (found, steps) = search(&mut control, &summary, asked_mw, &lookup);
                let at_once = whole_range(&summary, asked_mw, &lookup, control.factor_q10);
                // One step of the grid.
                let tolerance = grid_step_hz(at_once) * 5 / 4;
                assert!(
                    found.abs_diff(at_once) <= tolerance,
                    "{asked_mw} {f_sw_hz} {plant_percent}: {found} {at_once}"
                );
                let (_, steps_if_taught) =
                    search(&mut PowerControl::default(), &summary, asked_mw, &taught);
                most_steps = most_steps.max(steps).max(steps_if_taught);
            }
        }
    }
    assert!(
        most_steps >= STEPS_PER_SEARCH - 1,
        "{most_steps}: tighten it"
    );
}

/// At the start of a half-cycle of 60 Hz, at any frequency, there are blocks enough.
#[test]
fn a_search_ends_well_before_the_next_zero_crossing() {
    for f_sw_hz in [F_SW_MIN_HZ, F_SW_MAX_HZ] {
        let block_ns = ihd_shared::sampling::block_ns(f_sw_hz);
        assert!((1 + STEPS_PER_SEARCH) * block_ns < 8_333_333 / 5);
    }
}

/// The prior, with every cell observed.
fn observed_everywhere() -> RlLookup {
    let mut lookup = prior();
    lookup.observed.fill(0xFF);
    lookup
}

/// A half-cycle at 70 kHz, where the prior's load takes 560 W of 325 V, on a bus of so many decivolt.
fn with_bus(bus_peak_dv: u16) -> HalfCycle {
    let f_sw_hz = pwm::nearest_hz(70_000);
    let (r, l) = prior().interpolate(f_sw_hz, 20_000);
    let predicted = predict(&prior(), f_sw_hz, 3_253).unwrap();
    HalfCycle {
        f_sw_hz,
        power_mw: predicted.power_mw as u32,
        bus_peak_dv,
        crest: crest(r, l, 20_000),
        ..HalfCycle::default()
    }
}

#[test]
fn the_power_stops_rising_before_the_bus_trips() {
    let next = |bus_dv, asked_mw| {
        let mut control = PowerControl::default();
        let (f_sw_hz, _) = search(&mut control, &with_bus(bus_dv), asked_mw, &prior());
        (f_sw_hz, control.limit())
    };
    let now = pwm::nearest_hz(70_000);
    assert_eq!(next(PLANNED_BUS_DV, 1_500_000), (now, Limit::BusVoltage));
    let (near, limit) = next(PLANNED_BUS_DV - 1, 1_500_000);
    let step = STEP_DOWN_HZ / 4 + grid_step_hz(now);
    assert!((now - step..now).contains(&near), "{near}");
    assert_eq!(limit, Limit::None);
    let (less, limit) = next(PLANNED_BUS_DV, 300_000);
    assert!(less > now && limit == Limit::None, "{less} {limit:?}");
}

#[test]
fn after_a_jump_to_too_much_power_even_a_taught_lookup_is_followed_in_steps() {
    let taught = observed_everywhere();
    let next = |control: &mut PowerControl| search(control, &with_bus(3_253), 1_500_000, &taught).0;
    let step = STEP_DOWN_HZ + grid_step_hz(F_SW_MAX_HZ);
    let now = pwm::nearest_hz(70_000);
    let mut control = PowerControl::default();
    control.note_trip();
    assert!(next(&mut control) < now - 2 * step);
    control.note_trip();
    assert!((now - step..now).contains(&next(&mut control)));
    control.restart();
    assert!(next(&mut control) < now - 2 * step);
}

/// Half of the coil's current is the bus's: 20 A swing 1.5 µF by 15 V at 70 kHz, and 4.7 µF by 4.8 V.
#[test]
fn a_small_link_is_approached_in_steps() {
    let taught = observed_everywhere();
    for (c_2, jumps) in [
        (1e-6, false),
        (1.5e-6, false),
        (4.7e-6, true),
        (10e-6, true),
    ] {
        let mut summary = with_bus(3_253);
        let f_hz = f64::from(summary.f_sw_hz);
        let ripple_v = 10.0 / (core::f64::consts::TAU * f_hz * c_2);
        summary.crest.bus = reading(f_hz, 325.3, (ripple_v, 0.3), 0);
        let mut control = PowerControl::default();
        let (next, _) = search(&mut control, &summary, 1_500_000, &taught);
        let step = STEP_DOWN_HZ + grid_step_hz(F_SW_MAX_HZ);
        assert_eq!(next < summary.f_sw_hz - 2 * step, jumps, "{c_2}: {next}");
    }
}
