//! The series tank in integers: reactances, impedance, phase, distance from resonance. Its capacitance is C_r with what C2 adds.

use ihd_shared::hob::{RESONANCE_CAPACITANCE_NF, TANK_CAPACITANCE_PF};
use ihd_shared::units::{MicroOhm, PicoHenry};
use micromath::F32Ext;

use crate::fixed::{quotient, saturate};

/// Load and capacitor in series at one switching frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tank {
    /// Resistance, in milliohm.
    pub r_mohm: i64,
    /// Reactance of the coil, in milliohm.
    pub x_l_mohm: i64,
    /// Reactance of the capacitor as a positive number, in milliohm.
    pub x_c_mohm: i64,
}

/// Part of the tank that depends on the switching frequency alone: the divisions of 64 bit.
#[derive(Clone, Copy, Debug)]
pub struct TankAt {
    /// 2πf in milliohm per picohenry, 42-bit fixed point: below 2^33.
    omega_q42: u64,
    x_c_mohm: i64,
}

impl TankAt {
    /// Computes it for a switching frequency in hertz, up to 300 kHz.
    pub fn new(f_sw_hz: u32) -> Self {
        /// 2π · 1e-9 · 2^42, in thousandths.
        const OMEGA_PER_HZ: u64 = 27_633_741;
        let f = u64::from(f_sw_hz.clamp(1, 300_000));
        Self {
            omega_q42: f * OMEGA_PER_HZ / 1_000,
            // 1/(2πfC) in milliohm: 1e15 / (6.2832 · f · C_pF).
            x_c_mohm: (10_000_000_000_000_000_000 / (62_832 * f * u64::from(TANK_CAPACITANCE_PF)))
                as i64,
        }
    }

    /// The tank of a load.
    pub fn with_load(self, r: MicroOhm, l: PicoHenry) -> Tank {
        // 33 by 31 bit.
        let x_l_mohm = (self.omega_q42 * l.0.max(0) as u64) >> 42;
        Tank {
            r_mohm: i64::from(r.0 / 1_000),
            x_l_mohm: x_l_mohm as i64,
            x_c_mohm: self.x_c_mohm,
        }
    }
}

impl Tank {
    /// The tank of a load at a switching frequency in hertz.
    pub fn new(f_sw_hz: u32, r: MicroOhm, l: PicoHenry) -> Self {
        TankAt::new(f_sw_hz).with_load(r, l)
    }

    /// The same with so many times the capacitor's reactance, in 1/1024.
    pub fn with_series(self, series_q10: u32) -> Self {
        Self {
            x_c_mohm: (self.x_c_mohm * i64::from(series_q10)) >> 10,
            ..self
        }
    }

    /// Net reactance, in milliohm; positive above resonance.
    pub fn x_mohm(self) -> i64 {
        self.x_l_mohm - self.x_c_mohm
    }

    /// Magnitude of the impedance, in milliohm.
    pub fn z_mohm(self) -> u64 {
        let x = self.x_mohm();
        let square = (self.r_mohm * self.r_mohm + x * x) as u64;
        // Below 65 ohm, which every load is, a root of 32 bit does.
        u32::try_from(square).map_or_else(|_| square.isqrt(), |square| square.isqrt().into())
    }

    /// Returns `true` if the frequency is above resonance with at least `percent` of the coil's reactance to
    /// spare.
    pub fn is_above_resonance(self, percent: i64) -> bool {
        100 * self.x_mohm() >= percent * self.x_l_mohm
    }

    /// Lag of the current behind the inverter's voltage, in milliradian; positive above resonance.
    /// micromath's arc tangent is good to 2 mrad, enough for a soft-switching margin.
    pub fn phase_mrad(self) -> i16 {
        (F32Ext::atan2(self.x_mohm() as f32, self.r_mohm as f32) * 1e3) as i16
    }
}

/// Reactance of the resonance capacitor alone as a positive number, in milliohm.
pub fn resonance_capacitor_mohm(f_sw_hz: u32) -> i64 {
    /// 1/2π in milliohm, hertz and nanofarad.
    const SCALE: u64 = 159_154_943_092;
    (SCALE / (u64::from(f_sw_hz.max(1)) * RESONANCE_CAPACITANCE_NF as u64)) as i64
}

/// The inductance that resonates with the capacitor at a switching frequency: with less, the
/// inverter runs below resonance. 1/((2πf)²·C).
pub fn resonant_inductance(f_sw_hz: u32) -> PicoHenry {
    /// 1e20 / (2π)²: henry per hertz² and farad, as picohenry and nanofarad, over ten.
    const SCALE: u64 = 2_533_029_591_058_444_300;
    const L_F_SQUARED: u64 = SCALE / TANK_CAPACITANCE_PF as u64 * 10_000;
    let f = u64::from(f_sw_hz.max(1_000));
    // No division of 64 bit: the sampling path comes here at a frequency step.
    PicoHenry(saturate(quotient(L_F_SQUARED, f * f)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;

    const C_F: f64 = TANK_CAPACITANCE_PF as f64 * 1e-12;

    /// 1/(1/1080 nF + 0.29736/4700 nF).
    #[test]
    fn the_link_takes_its_share_of_the_capacitance() {
        assert!((C_F - 1_010.92e-9).abs() < 0.05e-9, "{C_F}");
    }

    #[test]
    fn integers_follow_the_formulas() {
        for f in [34_000u32, 45_000, 80_000] {
            for l_uh in [2.0, 17.0, 25.0, 90.0] {
                let t = Tank::new(f, MicroOhm(3_250_000), PicoHenry((l_uh * 1e6) as i32));
                let x_l = TAU * f64::from(f) * l_uh * 1e-3;
                let x_c = 1e3 / (TAU * f64::from(f) * C_F);
                assert!((t.x_l_mohm as f64 - x_l).abs() <= 1.0 + 1e-5 * x_l);
                assert!((t.x_c_mohm as f64 - x_c).abs() <= 1.0 + 1e-5 * x_c);
                let z = (x_l - x_c).hypot(3250.0);
                assert!((t.z_mohm() as f64 - z).abs() <= 3.0);
                let phase = (x_l - x_c).atan2(3250.0) * 1e3;
                assert!((f64::from(t.phase_mrad()) - phase).abs() < 4.0);
            }
        }
    }

    #[test]
    fn resonant_inductance_follows_its_formula() {
        for f in [34_000u32, 45_000, 80_000] {
            let l = 1e12 / ((TAU * f64::from(f)).powi(2) * C_F);
            assert!((f64::from(resonant_inductance(f).0) / l - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_tank_is_above_or_below_resonance() {
        // 20 µH and 1011 nF resonate at 35.40 kHz.
        let at = |f| Tank::new(f, MicroOhm(3_000_000), PicoHenry(20_000_000));
        assert!(!at(35_200).is_above_resonance(0));
        assert!(at(35_600).is_above_resonance(0));
        assert!(!at(35_600).is_above_resonance(10));
        assert!(at(39_300).is_above_resonance(10));
    }
}
