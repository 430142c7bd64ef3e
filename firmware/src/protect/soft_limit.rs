//! Soft limits: checks that raise the frequency within a block, before a trip would open both switches.
//!
//! Each block is checked in four ways, by sums and samples that exist anyway:
//! - the largest current and coil voltage, where a sample is out of the ordinary;
//! - resonance: ωL of the block's fundamental, Im(V·I*)/|I|², against the capacitor's reactance;
//! - the current at which either switch turned off, against what the node's capacitance needs within
//!   the dead time: I = C·V/t.
//!
//! The samples are locked to the carrier, so the one after each turn-off is known: of 61 over three
//! periods, the 51st lies 1/122 of a period after the upper switch's and the 41st 1/61 after the lower
//! one's. The anti-alias filter's 0.3 µs put what they show before the turn-off, where the current is a
//! little larger; [`SOFT_TURN_OFF_PERCENT`] has room for it.

use ihd_shared::hob::NODE_CAPACITANCE_NF;
use ihd_shared::sampling::{ADC_LOCK_P, AMPERE_PER_CODE, I_FULL_SCALE_A, Pair, V_FULL_SCALE_V};
use ihd_shared::units::PicoHenry;
use ihd_shared::wire::messages::Limit;

use crate::drive::pwm::DEAD_TIME_NS;
use crate::drive::soft_start;
use crate::fixed::Complex;
use crate::limits::{
    SOFT_HOLD_BLOCKS, SOFT_RESONANCE_PERCENT, SOFT_SWITCHING_FROM_DV, SOFT_TURN_OFF_PERCENT,
};
use crate::sense::codes::{SOFT_CURRENT_CODE, SOFT_VOLTAGE_CODE};
use crate::sense::correlation::BlockSums;

/// Samples after the turn-off of upper and lower switch.
const AFTER_UPPER: usize = 51;
const AFTER_LOWER: usize = 41;

const _: () = assert!(
    // Positions in the period, in 1/61: 31 and 1.
    (3 * AFTER_UPPER) % ADC_LOCK_P == 31 && (3 * AFTER_LOWER) % ADC_LOCK_P == 1
);

/// Below this amplitude of the block's current resonance is not checked: 3 A.
const MIN_CURRENT_CODE: f64 = 3.0 / AMPERE_PER_CODE;

/// |I|² of that amplitude, in sums shifted by [`SHIFT`]: an amplitude A sums to A·61/2 in 14 bits.
const MIN_NORM: i64 = {
    let sum = MIN_CURRENT_CODE * (ADC_LOCK_P as f64) * 0.5 * ((1 << 14) as f64)
        / ((1_i64 << SHIFT) as f64);
    (sum * sum) as i64
};

/// Sums of 31 bit lose so many, so that squares times a factor of 20 bit fit 64.
const SHIFT: u32 = 10;

/// Milliampere that the node needs at a bus of one decivolt, in 1/1024: C/t = nF/ns·1e3 mA/V.
const NEED_MA_PER_DV_Q10: u32 = NODE_CAPACITANCE_NF * 1_000 * 1_024 / 10 / DEAD_TIME_NS;

/// Current that must flow at a turn-off for the node to reach the other rail within the dead time, in
/// milliampere, at a bus voltage in decivolt.
pub fn turn_off_need_ma(bus_dv: u16) -> u32 {
    (u32::from(bus_dv) * NEED_MA_PER_DV_Q10) >> 10
}

/// The checks of one frequency.
#[derive(Clone, Debug, Default)]
pub struct SoftLimits {
    /// Capacitor's reactance with the margin, times ampere per volt of a code, in 1/65536.
    reactance_q16: i64,
    hold: u8,
}

/// Result of the checks of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SoftLimitCheck {
    /// The limit that acts.
    pub limit: Limit,
    /// Smallest current at a turn-off, in milliampere; `None` with too little on the bus, or just after a change.
    pub turn_off_ma: Option<i32>,
}

impl SoftLimits {
    pub(crate) const fn blank() -> Self {
        Self {
            reactance_q16: 0,
            hold: 0,
        }
    }

    /// Another frequency begins: nothing acts until its first blocks are over.
    ///
    /// `l_min` resonates with the capacitor there, so X_C is ωL of it: no division.
    pub fn set_frequency(&mut self, f_sw_hz: u32, l_min: PicoHenry) {
        /// Ampere per volt of a code, with the margin, in 1/65536 and per milliohm.
        const PER_MOHM_Q32: u64 = (4_294_967.296 * I_FULL_SCALE_A / V_FULL_SCALE_V * 100.0
            / (100 - SOFT_RESONANCE_PERCENT) as f64) as u64;
        /// 2π in milliohm per hertz and picohenry, 2π·1e-9, in 2^-40.
        const OMEGA_Q40: u64 = 6_908;
        let x_c_mohm =
            (((u64::from(f_sw_hz) * u64::from(l_min.0.unsigned_abs())) >> 8) * OMEGA_Q40) >> 32;
        self.reactance_q16 = ((x_c_mohm * PER_MOHM_Q32) >> 16) as i64;
        self.hold = SOFT_HOLD_BLOCKS;
    }

    /// A soft start begins: nothing acts until it is over, as the switches turn off at other samples.
    pub fn hold_start(&mut self) {
        self.hold = SOFT_HOLD_BLOCKS + soft_start::BLOCKS;
    }

    /// Looks at a block of a bridge that switches.
    pub fn check(
        &mut self,
        sums: &BlockSums,
        pairs: &[Pair; ADC_LOCK_P],
        bus_dv: u16,
    ) -> SoftLimitCheck {
        let held = self.hold > 0;
        let turn_off_ma = (!held && bus_dv >= SOFT_SWITCHING_FROM_DV).then(|| turn_off_ma(pairs));
        self.hold = self.hold.saturating_sub(1);
        let limit = if held {
            Limit::None
        } else if sums.i_peak >= SOFT_CURRENT_CODE {
            Limit::Current
        } else if sums.v_peak >= SOFT_VOLTAGE_CODE {
            Limit::CoilVoltage
        } else if self.is_near_resonance(sums) {
            Limit::Resonance
        } else if turn_off_ma.is_some_and(|ma| is_too_little(ma, bus_dv)) {
            Limit::SoftSwitching
        } else {
            Limit::None
        };
        SoftLimitCheck { limit, turn_off_ma }
    }

    /// Im(V·I*) < |I|²·X_C / (1 − margin), in codes.
    fn is_near_resonance(&self, sums: &BlockSums) -> bool {
        let shifted = |z: Complex| (i64::from(z.re >> SHIFT), i64::from(z.im >> SHIFT));
        let ((v_re, v_im), (i_re, i_im)) = (shifted(sums.v), shifted(sums.i));
        let norm = i_re * i_re + i_im * i_im;
        norm >= MIN_NORM && (v_im * i_re - v_re * i_im) << 16 < norm * self.reactance_q16
    }
}

/// Smallest current at a turn-off, in milliampere: out of the node at the upper switch's, into it at
/// the lower one's.
fn turn_off_ma(pairs: &[Pair; ADC_LOCK_P]) -> i32 {
    /// Milliampere per code, in 1/256.
    const MA_PER_CODE_Q8: i32 = (AMPERE_PER_CODE * 256_000.0) as i32;
    let code = pairs[AFTER_UPPER]
        .i
        .min(pairs[AFTER_LOWER].i.saturating_neg());
    (i32::from(code) * MA_PER_CODE_Q8) >> 8
}

fn is_too_little(turn_off_ma: i32, bus_dv: u16) -> bool {
    let need_ma = turn_off_need_ma(bus_dv) * SOFT_TURN_OFF_PERCENT / 100;
    i64::from(turn_off_ma) < i64::from(need_ma)
}

#[cfg(test)]
mod tests {
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

    fn check(f_hz: u32, pairs: &[Pair; ADC_LOCK_P], bus_dv: u16) -> SoftLimitCheck {
        let mut soft = SoftLimits::default();
        soft.set_frequency(f_hz, resonant_inductance(f_hz));
        let mut last = None;
        for _ in 0..=SOFT_HOLD_BLOCKS {
            last = Some(soft.check(&correlate(pairs), pairs, bus_dv));
        }
        last.expect("at least one")
    }

    #[test]
    fn resonance_is_seen_at_its_margin() {
        for f_hz in [36e3, 50e3, 75e3] {
            let x_c = 1e12 / (TAU * f_hz * f64::from(TANK_CAPACITANCE_PF));
            for (percent, limit) in [(2.0, Limit::Resonance), (6.0, Limit::None)] {
                let l_h = x_c / (1.0 - percent / 100.0) / (TAU * f_hz);
                for (r, i) in [(0.3, 30.0), (4.0, 40.0), (4.0, 5.0)] {
                    let pairs = block(f_hz, r, l_h, i, 0.2);
                    let seen = check(f_hz as u32, &pairs, 0);
                    assert_eq!(seen.limit, limit, "{f_hz} {percent} {r} {i}");
                }
            }
        }
    }

    #[test]
    fn resonance_is_checked_from_3_a_on() {
        let l_h = 1e12 / f64::from(TANK_CAPACITANCE_PF) / (TAU * 50e3).powi(2) / 0.98;
        for (i_a, limit) in [(2.9, Limit::None), (3.1, Limit::Resonance)] {
            let pairs = block(50e3, 4.0, l_h, i_a, 0.2);
            assert_eq!(check(50_000, &pairs, 0).limit, limit, "{i_a}");
        }
    }

    /// 15 nF at 300 V are 4.5 µC, which 4.5 A move in a microsecond.
    #[test]
    fn the_turn_off_current_must_move_the_nodes_charge() {
        assert_eq!(turn_off_need_ma(3_000), 4_500);
        // Lag of a quarter: the turn-off is at the crest.
        let seen = |i_a| check(60_000, &block(60e3, 1.0, 60e-6, i_a, 0.25), 3_000);
        assert_eq!(seen(6.0).limit, Limit::None);
        assert_eq!(seen(4.8).limit, Limit::SoftSwitching);
        let ma = seen(6.0).turn_off_ma.expect("300 V");
        assert!((5_800..=6_050).contains(&ma), "{ma}");
        // A current that leads turns off the wrong way.
        let leading = check(60_000, &block(60e3, 1.0, 60e-6, 20.0, 0.9), 3_000);
        assert!(leading.turn_off_ma.expect("300 V") < 0);
        assert_eq!(leading.limit, Limit::SoftSwitching);
        assert_eq!(
            check(60_000, &block(60e3, 1.0, 60e-6, 4.0, 0.25), 300).limit,
            Limit::None
        );
    }

    #[test]
    fn large_samples_act_before_they_trip() {
        let seen = |i_a, l_h| check(60_000, &block(60e3, 1.0, l_h, i_a, 0.2), 0).limit;
        assert_eq!(seen(72.0, 12e-6), Limit::None);
        assert_eq!(seen(74.0, 12e-6), Limit::Current);
        assert_eq!(seen(40.0, 40e-6), Limit::CoilVoltage);
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
}
