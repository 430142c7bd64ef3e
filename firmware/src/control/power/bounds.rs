//! Bounds that a frequency must keep: current, coil voltage, distance from resonance, soft switching.
//!
//! Predicted at the crest of the mains for the load as it was measured last: the built-in prior's R and
//! L, each times the ratio of the measured to the prior's. No lookup has a say in it.

use core::f64::consts::PI;

use ihd_shared::hob::{RESONANCE_CAPACITANCE_NF, TANK_CAPACITANCE_PF};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::messages::Limit;

use crate::control::bus_ripple::BRIDGE_SHARE;
use crate::control::pot::PRIOR;
use crate::drive::bridge::fundamental_uv;
use crate::estimate::tank::{Tank, TankAt, resonance_capacitor_mohm};
use crate::limits::{
    PLANNED_COIL_VOLTAGE_DV, PLANNED_CURRENT_MA, RESONANCE_MARGIN_PERCENT, TURN_OFF_PERCENT,
};
use crate::protect::soft_limit::{half_dead_time_fall_ma, turn_off_need_ma};
use crate::sampling::half_cycle::HalfCycle;

/// Rounds of the fixed point: from the measured current in proportion to the bus, four leave 1 %.
const ITERATIONS: u32 = 4;

/// The load and the bus that bound the frequency.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bounds {
    /// Measured R and L over the prior's at the same frequency and current, in 1/1024.
    r_q10: u32,
    l_q10: u32,
    i_ma: u32,
    bus_dv: u16,
    /// Reactance that capacitor and link put in series with the load, over the tank's, in 1/1024.
    series_q10: u16,
}

impl Bounds {
    /// Bounds for the load of a half-cycle, on a bus of `bus_dv` at the crest.
    pub fn new(summary: &HalfCycle, bus_dv: u16) -> Self {
        let (r, l) = PRIOR.interpolate(summary.f_sw_hz, summary.crest.i_ma);
        // 10 mohm and 1 µH at least stand for an estimate at its bound.
        let ratio = |is: i32, of: i32| ((i64::from(is.max(1)) << 10) / i64::from(of.max(1))) as u32;
        Self {
            r_q10: ratio(summary.crest.r.0, r.0).clamp(2, 8 << 10),
            l_q10: ratio(summary.crest.l.0, l.0).clamp(2, 8 << 10),
            i_ma: summary.crest.i_ma,
            bus_dv,
            series_q10: 1 << 10,
        }
    }

    /// The same behind a link smaller than the tank's, of which the half-cycle shows so much ripple, in decivolt: its share of the
    /// bridge's voltage lags the current by a quarter of the period, as a capacitor's.
    pub fn with_small_link(self, summary: &HalfCycle, ripple_dv: u16) -> Self {
        /// Share in millivolt per decivolt.
        const SHARE_MV: u64 = (BRIDGE_SHARE * 100.0) as u64;
        let link_mohm =
            u64::from(ripple_dv) * SHARE_MV * 1_000 / u64::from(summary.crest.i_ma.max(1));
        let series_mohm = resonance_capacitor_mohm(summary.f_sw_hz).unsigned_abs() + link_mohm;
        let tank_mohm = Tank::new(summary.f_sw_hz, MicroOhm(0), PicoHenry(0))
            .x_c_mohm
            .unsigned_abs();
        let series_q10 = (series_mohm << 10) / tank_mohm.max(1);
        Self {
            series_q10: series_q10.clamp(1 << 10, 4 << 10) as u16,
            ..self
        }
    }

    /// L over the prior's, in 1/1024.
    pub fn l_q10(&self) -> u32 {
        self.l_q10
    }

    /// Limit that forbids a frequency; [`Limit::None`] if none does.
    pub fn limit_at(&self, f_sw_hz: u32) -> Limit {
        let v1_uv = fundamental_uv(self.bus_dv);
        let (prior, tank_at) = (PRIOR.at_frequency(f_sw_hz), TankAt::new(f_sw_hz));
        let tank = |i_ma: u32| {
            let (r, l) = prior.interpolate(i_ma);
            let scaled = |x: i32, q10: u32| ((i64::from(x) * i64::from(q10)) >> 10) as i32;
            tank_at.with_load(
                MicroOhm(scaled(r.0, self.r_q10)),
                PicoHenry(scaled(l.0, self.l_q10)),
            )
        };
        let mut i_ma = self.i_ma;
        for _ in 0..ITERATIONS {
            i_ma = v1_uv / tank(i_ma).z_mohm().clamp(1, u64::from(u32::MAX)) as u32;
        }
        let tank = tank(i_ma);
        // The coil's largest voltage: half the bus and the capacitor's, whose extreme falls into it.
        let coil_dv =
            u64::from(self.bus_dv / 2) + u64::from(i_ma) * tank.x_c_mohm.unsigned_abs() / 100_000;
        let seen = tank.with_series(self.series_q10.into());
        let i3_ma = third_harmonic_ma(&tank, v1_uv);
        if crest_ma(&tank, i_ma, i3_ma) > i64::from(PLANNED_CURRENT_MA) {
            Limit::Current
        } else if coil_dv > u64::from(PLANNED_COIL_VOLTAGE_DV) {
            Limit::CoilVoltage
        } else if !seen.is_above_resonance(RESONANCE_MARGIN_PERCENT) {
            Limit::Resonance
        } else if self.turn_off_spare_ma(f_sw_hz, v1_uv, [&tank, &seen], i3_ma) < 0 {
            Limit::SoftSwitching
        } else {
            Limit::None
        }
    }

    /// Turn-off current above what is kept of it, in milliampere: I·sin φ and the harmonics, less the second one of the bus's ripple,
    /// which one of the switches has against it. `seen` is the tank with the link in series.
    fn turn_off_spare_ma(
        &self,
        f_sw_hz: u32,
        v1_uv: u32,
        [tank, seen]: [&Tank; 2],
        i3_ma: i64,
    ) -> i64 {
        /// Reactance of C_r over the tank's, in 1/1024.
        const RESONANCE_Q10: i64 =
            (TANK_CAPACITANCE_PF as i64 * 1_024) / (RESONANCE_CAPACITANCE_NF as i64 * 1_000);
        /// Second harmonic of the bridge's voltage over the reactance that the link has for the first, in 1/1024: while the upper
        /// switch is on the bus leaves its mean by (cos θ − ½ + θ/π)·I/ωC, whose share is (4/3 − 1/2)/π.
        const SECOND_Q10: i64 = ((4.0 / 3.0 - 0.5) / PI * 2.0 / BRIDGE_SHARE * 1_024.0) as i64;
        let z_mohm = seen.z_mohm().max(1) as i64;
        let i_ma = i64::from(v1_uv) / z_mohm;
        let x_c_mohm = (tank.x_c_mohm * RESONANCE_Q10) >> 10;
        let second_mohm = ((seen.x_c_mohm - x_c_mohm) * SECOND_Q10) >> 10;
        let second_ma = i_ma * second_mohm / (2 * seen.x_l_mohm - x_c_mohm / 2).max(1);
        // A square wave's harmonics are 1/n² of V1/X_L each: together twice the third.
        let turn_off_ma = i_ma * seen.x_mohm() / z_mohm + 2 * i3_ma - second_ma;
        let fall_ma = half_dead_time_fall_ma(f_sw_hz, i_ma * seen.r_mohm / z_mohm);
        let need_ma = turn_off_need_ma(self.bus_dv, fall_ma) * TURN_OFF_PERCENT / 100;
        turn_off_ma - i64::from(need_ma)
    }
}

/// Third harmonic of the current, in milliampere: a third of the voltage into nearly its reactance alone.
fn third_harmonic_ma(tank: &Tank, v1_uv: u32) -> i64 {
    let x3_mohm = 3 * tank.x_l_mohm - tank.x_c_mohm / 3;
    i64::from(v1_uv / 3) / x3_mohm.max(1)
}

/// The largest current: I1 − I3·sin 3φ, as at the fundamental's crest the third harmonic of a square
/// wave stands there. It flattens the crest of a good pot's current (φ = 40°) and sharpens a small one's (75°).
fn crest_ma(tank: &Tank, i_ma: u32, i3_ma: i64) -> i64 {
    let sine_q10 = (tank.x_mohm() << 10) / tank.z_mohm().max(1) as i64;
    let triple_q10 = 3 * sine_q10 - ((4 * sine_q10 * sine_q10 * sine_q10) >> 20);
    i64::from(i_ma) - ((i3_ma * triple_q10) >> 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::half_cycle::CurrentCrest;
    use std::f64::consts::{FRAC_2_PI, TAU};

    fn summary(f_hz: u32, r: f64, l_uh: f64, i_a: f64) -> HalfCycle {
        HalfCycle {
            f_sw_hz: f_hz,
            crest: CurrentCrest {
                r: MicroOhm((r * 1e6) as i32),
                l: PicoHenry((l_uh * 1e6) as i32),
                i_ma: (i_a * 1e3) as u32,
                ..CurrentCrest::default()
            },
            ..HalfCycle::default()
        }
    }

    /// The oracle in f64, for a load of constant ratio to the prior's own law.
    fn oracle(f_hz: f64, r_ratio: f64, l_ratio: f64, bus_v: f64) -> [f64; 4] {
        let x = f_hz / 45e3;
        let (mut i, mut r, mut x_l) = (10.0, 0.0, 0.0);
        let x_c = 1e12 / (TAU * f_hz * f64::from(TANK_CAPACITANCE_PF));
        for _ in 0..200 {
            r = r_ratio * (3.0 + 4.0 / (1.0 + i / 9.0)) * x.sqrt();
            let l = l_ratio * (20.5 + 18.0 / (1.0 + i / 10.0)) * 1e-6 * x.powf(-0.3);
            x_l = TAU * f_hz * l;
            i = 0.5 * (i + FRAC_2_PI * bus_v / r.hypot(x_l - x_c));
        }
        let x = x_l - x_c;
        let phi = x.atan2(r);
        let i3 = FRAC_2_PI * bus_v / 3.0 / (3.0 * x_l - x_c / 3.0);
        let crest = i - i3 * (3.0 * phi).sin();
        // Harmonics of the square wave at its edge, and against them the second of the ripple of 4.7 µF.
        let harmonics: f64 = (3..2_000)
            .step_by(2)
            .map(f64::from)
            .map(|n| FRAC_2_PI * bus_v / n / (n * x_l - x_c / n))
            .sum();
        let (x_link, x_c_r) = (1e6 / (TAU * f_hz * 4.7), 1e6 / (TAU * f_hz * 1.08));
        let second = i * x_link * (5.0 / 6.0 / PI) / (2.0 * x_l - x_c_r / 2.0);
        let turn_off = i * phi.sin() + harmonics - second;
        // 15 nF within a microsecond while the current falls by ω·I·cos φ, and no reversal in it.
        let fall = TAU * f_hz * 1e-6 * i * phi.cos();
        let need = (15e-3 * bus_v + 0.5 * fall).max(fall);
        [crest, bus_v / 2.0 + i * x_c, x / x_l, turn_off / need]
    }

    /// Going down in frequency, the first limit is the oracle's, within 2 % of its quantity.
    #[test]
    fn the_first_limit_is_that_of_the_physics() {
        for (r_ratio, l_ratio) in [(1.0, 1.0), (0.3, 1.3), (0.2, 0.7), (1.3, 0.85)] {
            for bus_v in [255.0, 325.0, 375.0] {
                let x = 79e3 / 45e3_f64;
                let r = r_ratio * (3.0 + 4.0 / (1.0 + 15.0 / 9.0)) * x.sqrt();
                let l = l_ratio * (20.5 + 18.0 / (1.0 + 1.5)) * x.powf(-0.3);
                let bounds = Bounds::new(&summary(79_000, r, l, 15.0), (bus_v * 10.0) as u16);
                let mut f_hz = 79_000;
                while f_hz > 34_000 && bounds.limit_at(f_hz) == Limit::None {
                    f_hz -= 100;
                }
                let [i_a, coil_v, margin, turn_off] =
                    oracle(f64::from(f_hz), r_ratio, l_ratio, bus_v);
                match bounds.limit_at(f_hz) {
                    Limit::Current => assert!((i_a / 70.0 - 1.0).abs() < 0.03, "{i_a}"),
                    Limit::CoilVoltage => assert!((coil_v / 540.0 - 1.0).abs() < 0.03, "{coil_v}"),
                    Limit::Resonance => assert!((margin - 0.12).abs() < 0.01, "{margin}"),
                    Limit::SoftSwitching => {
                        assert!((turn_off / 1.5 - 1.0).abs() < 0.04, "{turn_off}");
                    }
                    other => assert_eq!(other, Limit::None),
                }
                assert!(i_a < 72.0 && coil_v < 555.0 && margin > 0.11);
            }
        }
    }

    /// The ripple of 1 µF is half the current in its reactance. In series with C_r it is 1/(1/1080 nF + 0.29736/1000 nF), 817 nF.
    #[test]
    fn a_small_link_moves_the_resonance() {
        let (f_hz, l_uh, i_a) = (41_000, 20.0, 38.0);
        let load = summary(f_hz, 4.0, l_uh, i_a);
        let ripple_v = 0.5 * i_a * 1e6 / (TAU * f64::from(f_hz));
        let bounds = Bounds::new(&load, 2_500).with_small_link(&load, (ripple_v * 10.0) as u16);
        let lowest = (34_000..60_000)
            .step_by(50)
            .find(|&f_hz| bounds.limit_at(f_hz) != Limit::Resonance)
            .unwrap();
        // The prior's L falls by f^-0.3 from where it was measured.
        let x = f64::from(lowest) / f64::from(f_hz);
        let x_l = TAU * f64::from(lowest) * l_uh * 1e-6 * x.powf(-0.3);
        let margin = 1.0 - 1.0 / (TAU * f64::from(lowest) * 817.5e-9 * x_l);
        assert!((margin - 0.12).abs() < 0.015, "{lowest} {margin}");
    }

    #[test]
    fn a_recovered_mains_bounds_more_than_a_sagging_one() {
        let load = summary(40_000, 3.4, 24.0, 30.0);
        let lowest = |bus_dv| {
            let bounds = Bounds::new(&load, bus_dv);
            (34_000..80_000)
                .step_by(50)
                .find(|&f_hz| bounds.limit_at(f_hz) == Limit::None)
        };
        assert!(lowest(1_950) < lowest(3_740));
    }
}
