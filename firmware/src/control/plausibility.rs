//! Readings that contradict physics or each other, half-cycle by half-cycle.
//!
//! The coil's voltage and that of the resonance capacitor, I/(jωC), add up to the bridge's, whose
//! fundamental is 2/π of the bus. That ties the gains of three sensors together without a fourth: with
//! X_L and X_C the two reactances, a current that reads g times too much moves the sum by
//! (g − 1)·X_C, a voltage by (g − 1)·|R + jX_L|, the bus directly. Near 80 kHz X_C is a tenth of X_L
//! and an error of the current's gain is lost in the tolerances; a sensor of the DC link sees it there.
//!
//! The bare coil is a known impedance: nothing that a kitchen has raises its inductance. A pot probe without a pot that
//! finds more of it has a current that reads too little, or a voltage that reads too much; and the balance of voltage and bus at
//! the probe frequency hardly asks for C_r.
//!
//! `gain_drift` compares both with their own past, while a pot stays.
//!
//! A capacitor in series lets no direct current through, and a winding holds no direct voltage: the
//! means over whole periods are zero, bridge on or off. A current that swings through zero has codes on both
//! sides of it, unless a bit of its converter sticks.

use ihd_shared::board::BARE_COIL_NH;
use ihd_shared::fault::Fault;

use self::gain_drift::GainDrift;
use crate::control::bus_ripple::ripple_dv;
use crate::estimate::tank::{TankAt, resonance_capacitor_mohm};
use crate::fixed::{Complex, saturate};
use crate::limits::{
    BALANCE_PERCENT, BALANCE_TANK_PERCENT, BARE_COIL_MOHM, BARE_COIL_PERCENT,
    BUS_AT_CROSSING_PERCENT, BUS_MIN_DV, CURRENT_OFFSET_MA, IMPLAUSIBLE_HALF_CYCLES,
    IRREGULAR_HALF_CYCLES, LINK_CAPACITANCE_MAX_NF, POWER_BALANCE_PERCENT, PROBE_BALANCE_PERCENT,
    VOLTAGE_OFFSET_DV,
};
use crate::sampling::half_cycle::HalfCycle;
use crate::sampling::half_cycle_sums::filter_loss_q16;
use crate::sense::demodulator::{STATE_BITS, VOLT_PER_UNIT, amplitude_dv};

mod gain_drift;

/// A bus that a bench supply holds up, 60 V at most, is no zero crossing out of place.
const BENCH_BUS_DV: u32 = 600;

/// Share of the bus's ripple in the bridge's fundamental, per decivolt as a mantissa of the coil's voltage. While the upper switch is
/// on, a lagging current leaves the bus at a half-sine above its mean: its fundamental is a half, the bridge's 1/2 − 2/π².
const RIPPLE_SHARE_PER_DV: i64 =
    (0.594_715 * 0.1 / VOLT_PER_UNIT * (1_u64 << STATE_BITS) as f64) as i64;

/// Below this power the two powers are not compared: 200 W.
const POWER_FROM_MW: u32 = 200_000;

/// Contradictions between the measurements, each counted in half-cycles that it lasts.
#[derive(Clone, Debug, Default)]
pub struct Plausibility {
    balance: ContradictionCount,
    probe: ContradictionCount,
    offset: ContradictionCount,
    gap: ContradictionCount,
    current: ContradictionCount,
    power: ContradictionCount,
    bus: ContradictionCount,
    drift: GainDrift,
    /// A bit for each of the last eight half-cycles that was not as it must be.
    irregular: u8,
}

/// Half-cycles, or pot probes, in a row.
#[derive(Clone, Copy, Debug, Default)]
struct ContradictionCount(u8);

impl ContradictionCount {
    fn push(&mut self, bad: bool) -> bool {
        self.push_if(true, bad)
    }

    /// A half-cycle that shows nothing neither counts nor ends the count.
    fn push_if(&mut self, shows: bool, bad: bool) -> bool {
        if shows {
            self.0 = if bad { self.0.saturating_add(1) } else { 0 };
        }
        self.0 >= IMPLAUSIBLE_HALF_CYCLES
    }
}

impl Plausibility {
    /// Takes a half-cycle; the fault that has lasted long enough.
    pub fn on_half_cycle(&mut self, summary: &HalfCycle) -> Option<Fault> {
        let steady = summary.f_sw_hz > 0 && !summary.disturbed;
        // Without current the soft limits disturb every half-cycle.
        let on_bus = summary.f_sw_hz > 0 && summary.is_comparable();
        let flows = summary.has_coil_current();
        let seen = steady && on_bus && flows;
        // More than any offset that is none yet.
        let swings = summary.f_sw_hz > 0 && summary.crest.i_ma >= 2 * CURRENT_OFFSET_MA;
        let balance = BridgeBalance::of(summary);
        let checks = [
            (self.offset.push(has_offset(summary)), Fault::SENSOR_OFFSET),
            (
                self.gap.push_if(swings, summary.channels.i_gap),
                Fault::SENSOR_OFFSET,
            ),
            (
                self.balance.push_if(seen, !balance.is_within_tolerances()),
                Fault::BRIDGE_BALANCE,
            ),
            (
                seen && self.drift.push(summary, balance.ppm()),
                Fault::BRIDGE_BALANCE,
            ),
            (
                self.power.push_if(steady, !is_power_balanced(summary)),
                Fault::POWER_BALANCE,
            ),
            (self.current.push_if(on_bus, !flows), Fault::NO_COIL_CURRENT),
            (
                // On a bench without power the bridge may switch.
                self.bus
                    .push_if(summary.f_sw_hz > 0, summary.bus_peak_dv < BUS_MIN_DV),
                Fault::BUS_RANGE,
            ),
            (self.is_irregular(summary), Fault::MAINS_IRREGULAR),
        ];
        checks
            .into_iter()
            .find_map(|(bad, fault)| bad.then_some(fault))
    }

    /// Takes a pot probe; the fault that has lasted long enough.
    pub fn on_pot_probe(&mut self, summary: &HalfCycle) -> Option<Fault> {
        let flows = summary.is_comparable() && summary.has_coil_current();
        let is_bare = summary.crest.r.0 <= 1_000 * BARE_COIL_MOHM as i32;
        let l_ph = i64::from(summary.crest.l.0);
        let bare_ph = |percent: u32| i64::from(BARE_COIL_NH * 10 * percent);
        let balance = BridgeBalance::of(summary);
        let bad = if is_bare {
            l_ph > bare_ph(100 + BARE_COIL_PERCENT) || !balance.is_within(BARE_COIL_PERCENT)
        } else {
            !balance.is_within(PROBE_BALANCE_PERCENT)
        };
        if flows && is_bare && !bad && l_ph >= bare_ph(100 - BARE_COIL_PERCENT) {
            self.drift = GainDrift::default();
        }
        self.drift.leave();
        // A load that fits shows little of what the bare coil contradicts.
        let shows = flows && (is_bare || bad);
        self.probe
            .push_if(shows, bad)
            .then_some(Fault::BRIDGE_BALANCE)
    }

    /// Forgets what was counted; a gain that has drifted is none the better for it.
    pub fn reset(&mut self) {
        *self = Self {
            drift: core::mem::take(&mut self.drift),
            ..Self::default()
        };
    }

    fn is_irregular(&mut self, summary: &HalfCycle) -> bool {
        // A link that little discharges stays up, so only a bridge that carries power shows its zero.
        let limit_dv = u32::from(summary.bus_peak_dv) * BUS_AT_CROSSING_PERCENT / 100;
        let in_place = summary.f_sw_hz == 0
            || !discharges_link(summary)
            || u32::from(summary.bus_at_crossing_dv) <= limit_dv.max(BENCH_BUS_DV);
        self.irregular = self.irregular << 1 | u8::from(!(summary.is_in_time() && in_place));
        self.irregular.count_ones() >= IRREGULAR_HALF_CYCLES
    }
}

/// Returns `true` if the power of the half-cycle takes the charge of the DC link down to 15 % of the crest by the zero crossing.
///
/// A load of resistance R leaves the rectified sine at the angle θ before the crossing where tan θ = ωRC, and from there on the link
/// decays with RC: sin θ · exp(−θ/tan θ) of the crest is left at the crossing, 15 % with tan θ = 0.42. With P = V̂²/2R that is
/// P = ωC·V̂²/0.84, and ω is π a half-cycle.
fn discharges_link(summary: &HalfCycle) -> bool {
    let bus_dv = u64::from(summary.bus_peak_dv);
    // nF · dV² / ns = 1e-2 W; π/0.84 = 3.74.
    let least_mw = 3_740 * u64::from(LINK_CAPACITANCE_MAX_NF) * bus_dv * bus_dv
        / (100 * u64::from(summary.duration_ns.max(1)));
    u64::from(summary.power_mw) > least_mw
}

fn has_offset(summary: &HalfCycle) -> bool {
    summary.channels.i_offset_ma.unsigned_abs() >= CURRENT_OFFSET_MA
        || summary.channels.v_offset_dv.unsigned_abs() >= VOLTAGE_OFFSET_DV
}

/// The bridge's fundamental by coil and capacitor, less what the bus's ripple adds to it, against 2/π of the bus: amplitudes before
/// the anti-alias filter, at the crest of the current, in decivolt.
struct BridgeBalance {
    by_coil_dv: u32,
    by_bus_dv: u32,
    /// X_C·X/|Z|², by which an error of C_r or of the current's gain moves the sum, in permille; at most 1.
    by_tank_permille: u32,
}

impl BridgeBalance {
    fn of(summary: &HalfCycle) -> Self {
        // Without a frequency X_C has 38 bits.
        let x_c_mohm = i64::from(saturate(resonance_capacitor_mohm(summary.f_sw_hz)));
        let filtered_dv = bridge_dv(summary, x_c_mohm);
        // √(1 + x) ≈ 1 + x/2 of the anti-alias filter.
        let tank = TankAt::new(summary.f_sw_hz).with_load(summary.crest.r, summary.crest.l);
        let z_mohm = i64::from(saturate(tank.z_mohm() as i64));
        let by_tank = x_c_mohm * tank.x_mohm() / (z_mohm * z_mohm / 1_000).max(1);
        let loss_dv = (filtered_dv * (filter_loss_q16(summary.f_sw_hz) / 2)) >> 16;
        Self {
            by_coil_dv: filtered_dv + loss_dv,
            by_bus_dv: u32::from(summary.crest.bus.dv) * 6_366 / 10_000,
            by_tank_permille: by_tank.clamp(0, 1_000) as u32,
        }
    }

    /// Returns `true` if the two differ by no more than the parts and sensors of an honest board let them.
    fn is_within_tolerances(&self) -> bool {
        let tank_permille = BALANCE_TANK_PERCENT * self.by_tank_permille / 100;
        self.is_within_permille(10 * BALANCE_PERCENT + tank_permille)
    }

    fn is_within(&self, percent: u32) -> bool {
        self.is_within_permille(10 * percent)
    }

    fn is_within_permille(&self, permille: u32) -> bool {
        self.by_coil_dv.abs_diff(self.by_bus_dv) * 1_000 <= self.by_bus_dv * permille
    }

    /// Their ratio, in millionths.
    fn ppm(&self) -> i32 {
        saturate(i64::from(self.by_coil_dv) * 1_000_000 / i64::from(self.by_bus_dv.max(1)))
    }
}

/// Amplitude of |V + I/(jωC_r)| less the share of the bus's ripple, in decivolt.
fn bridge_dv(summary: &HalfCycle, x_c_mohm: i64) -> u32 {
    let (v, i) = (summary.crest.phasors.v, summary.crest.phasors.i);
    let ripple = ripple_dv(&summary.crest.bus, summary.f_sw_hz);
    // −jX·(a + jb) = bX − jaX; mantissas of 16 A and 32 V, so an ohm counts half.
    let part = |v: i32, i: i32, ripple_dv: i32| {
        let ripple = i64::from(ripple_dv) * RIPPLE_SHARE_PER_DV;
        saturate(i64::from(v) + i64::from(i) * x_c_mohm / 2_000 - ripple)
    };
    let sum = Complex {
        re: part(v.re, i.im, ripple.re),
        im: part(v.im, -i.re, ripple.im),
    };
    amplitude_dv(sum.norm_squared())
}

fn is_power_balanced(summary: &HalfCycle) -> bool {
    let Some(dc_link_mw) = summary.dc_link_mw else {
        return true;
    };
    let more = dc_link_mw.max(summary.power_mw);
    more < POWER_FROM_MW
        || u64::from(dc_link_mw.abs_diff(summary.power_mw)) * 100
            <= u64::from(more) * u64::from(POWER_BALANCE_PERCENT)
}

#[cfg(test)]
mod tests {
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
        (r, l_uh): (f64, f64),
        v_gain: f64,
        i_gain: f64,
        bus_gain: f64,
    ) -> HalfCycle {
        let x_l = TAU * f_hz * l_uh * 1e-6;
        let x_c = 1e9 / (TAU * f_hz * f64::from(RESONANCE_CAPACITANCE_NF));
        let v1 = FRAC_2_PI * 325.0;
        let z2 = r * r + (x_l - x_c).powi(2);
        // I = V1/Z with V1 real, V = I·(R + jX_L).
        let i = (v1 * r / z2, -v1 * (x_l - x_c) / z2);
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
                bus: BusReading::steady((3_250.0 * bus_gain) as u16),
                phasors: Phasors {
                    v: complex(v, v_gain, VOLT_PER_UNIT),
                    i: complex(i, i_gain, AMPERE_PER_UNIT),
                },
            },
            power_mw: 1_000_000,
            bus_peak_dv: (3_250.0 * bus_gain) as u16,
            ..HalfCycle::default()
        }
    }

    /// Half-cycle of a load at a link of so many farad that the line recharges evenly: its elastance counts 1/2 − 2/π² in the tank,
    /// and its ripple is that of half the coil's current.
    fn with_link(f_hz: f64, (r, l_uh): (f64, f64), c_2: f64) -> HalfCycle {
        let omega = TAU * f_hz;
        let mut summary = seen(f_hz, (r, l_uh), 1.0, 1.0, 1.0);
        let x_l = omega * l_uh * 1e-6;
        let x_r = 1e9 / (omega * f64::from(RESONANCE_CAPACITANCE_NF));
        let x = x_l - x_r - (0.5 - 0.5 * FRAC_2_PI * FRAC_2_PI) / (omega * c_2);
        let v1 = FRAC_2_PI * 325.0;
        let (z2, filter) = (r * r + x * x, f_hz / f64::from(ANTI_ALIAS_HZ));
        let i = (v1 * r / z2, -v1 * x / z2);
        let v = (i.0 * r - i.1 * x_l, i.0 * x_l + i.1 * r);
        // Behind the anti-alias filter: its amplitude here, its phase at the bus.
        let mantissa = |x: f64, unit: f64| {
            (x / unit / f64::hypot(1.0, filter) * f64::from(1u32 << STATE_BITS)) as i32
        };
        let complex = |(re, im): (f64, f64), unit: f64| Complex {
            re: mantissa(re, unit),
            im: mantissa(im, unit),
        };
        summary.crest.phasors = Phasors {
            v: complex(v, VOLT_PER_UNIT),
            i: complex(i, AMPERE_PER_UNIT),
        };
        // −I/2 · 1/(jωC).
        let ripple = (-i.1 / (2.0 * omega * c_2), i.0 / (2.0 * omega * c_2));
        let amplitude_and_phase = (
            ripple.0.hypot(ripple.1),
            ripple.1.atan2(ripple.0) + filter.atan(),
        );
        summary.crest.bus = reading(f_hz, 325.0, amplitude_and_phase, 1);
        summary
    }

    /// Within 1 %, of which the ripple's reading takes half, from the largest link down to one that is less than C_r.
    #[test]
    fn the_balance_holds_whatever_the_link() {
        for load in [POT, SMALL, (2.2, 33.0)] {
            for f_hz in [45e3, 60e3, 79e3] {
                for c_2 in [1e-6, 2.2e-6, 4.7e-6, 10e-6] {
                    let ppm = BridgeBalance::of(&with_link(f_hz, load, c_2)).ppm();
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
    fn the_bare_coil_shows_a_current_that_reads_too_little_and_a_voltage_that_does_not_fit_the_bus()
    {
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
}
