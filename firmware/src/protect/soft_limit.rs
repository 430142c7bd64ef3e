//! Soft limits: checks that raise the frequency within a block, before a trip would open both switches.
//!
//! Each block is checked in four ways, by sums and samples that exist anyway:
//! - pairs whose current or coil voltage is out of the ordinary;
//! - resonance: ωL of the block's fundamental, Im(V·I*)/|I|², against the capacitor's reactance;
//! - the current at which either switch turned off, against what the node's capacitance needs within
//!   the dead time, in which the current falls ([`turn_off_need_ma`]).
//!
//! No single sample acts: that is the comparator's, which sees no converter's noise. What a block lacks is summed
//! over blocks, never below zero, and acts from a sum on that the physics bears: a hard edge heats a switch by 1 mJ at
//! most, a crest above the soft limit is below the trip. A large shortage acts after one block, one that is near
//! nothing after many, and noise about a sound current adds up to nothing.
//!
//! The samples are locked to the carrier, so those about each turn-off are known: of 61 over three
//! periods, the 51st begins 1/122 of a period after the upper switch's, the first at the lower one's and the 41st 1/61
//! after it: their mean is of 1/122, too. They are held 0.18 µs later (trigger, latency, sampling time). Less the anti-alias
//! filter's 0.3 µs they show the current from 0.02 µs before the turn-off (80 kHz) to 0.12 µs after it (34 kHz), where it is smaller
//! and the limit acts early.

use core::f64::consts::{PI, TAU};

use ihd_shared::hob::{F_SW_MIN_HZ, NODE_CAPACITANCE_NF, RESONANCE_CAPACITANCE_NF};
use ihd_shared::sampling::{
    ADC_LOCK_P, AMPERE_PER_CODE, CODE_MAX, I_FULL_SCALE_A, Pair, V_FULL_SCALE_V,
};
use ihd_shared::units::PicoHenry;
use ihd_shared::wire::messages::Limit;

use crate::drive::pwm::DEAD_TIME_NS;
use crate::drive::soft_start;
use crate::fixed::Complex;
use crate::limits::{
    SOFT_HOLD_BLOCKS, SOFT_PAIRS, SOFT_RESONANCE_FROM_MA, SOFT_RESONANCE_PERCENT,
    SOFT_RESONANCE_SHORTAGE_PERCENT, SOFT_SWITCHING_FROM_DV, SOFT_TURN_OFF_PERCENT,
    SOFT_TURN_OFF_SHORTAGE_MA,
};
use crate::sense::correlation::{BlockSums, TABLE_BITS};

/// Samples after the turn-off of the upper switch, at and after the lower one's.
const AFTER_UPPER: usize = 51;
const AT_LOWER: usize = 0;
const AFTER_LOWER: usize = 41;

const _: () = assert!(
    // Positions in the period, in 1/61: 31, 0 and 1.
    (3 * AFTER_UPPER) % ADC_LOCK_P == 31 && AT_LOWER == 0 && (3 * AFTER_LOWER) % ADC_LOCK_P == 1
);

/// Amplitude of the block's current from which on resonance is checked: 3 A.
const MIN_CURRENT_CODE: f64 = 3.0 / AMPERE_PER_CODE;

const MIN_NORM: i64 = norm(MIN_CURRENT_CODE);

/// Amplitude from which on a block counts in full; below, by its current squared.
const FULL_NORM: i64 = norm(SOFT_RESONANCE_FROM_MA as f64 * 1e-3 / AMPERE_PER_CODE);

/// Largest |I|² of samples within their range: that of a square wave.
const MAX_NORM: i64 = norm(4.0 / PI * (CODE_MAX as f64 + 1.0));

/// Largest factor of |I|²: the capacitor's reactance at the lowest frequency, with the margin, times ampere per volt of a code.
const MAX_REACTANCE_Q16: f64 = 65_536e9
    / (TAU * F_SW_MIN_HZ as f64 * RESONANCE_CAPACITANCE_NF as f64)
    * (I_FULL_SCALE_A / V_FULL_SCALE_V)
    * (100.0 / (100 - SOFT_RESONANCE_PERCENT) as f64);

// A shortage is the difference of two products, and is added to the last blocks'.
const _: () = assert!(
    (if MAX_NORM > FULL_NORM {
        MAX_NORM
    } else {
        FULL_NORM
    }) as f64
        * MAX_REACTANCE_Q16
        < i64::MAX as f64 / 4.0,
    "the board file's coil_current_full_scale_ma is too large beside coil_voltage_full_scale_mv, \
     resonance_capacitance_nf and f_sw_min_hz: products of the resonance check exceed 64 bit"
);

/// |I|² of an amplitude in codes, in sums shifted by [`SHIFT`]: an amplitude A sums to A·61/2 in 14 bits.
const fn norm(amplitude_code: f64) -> i64 {
    let sum =
        amplitude_code * (ADC_LOCK_P as f64) * 0.5 * ((1 << 14) as f64) / ((1_i64 << SHIFT) as f64);
    (sum * sum) as i64
}

/// Sums of 31 bit lose so many, so that squares times a factor of 20 bit fit 64.
const SHIFT: u32 = 10;

/// Milliampere that the node needs at a bus of one decivolt, in 1/1024: C/t = nF/ns·1e3 mA/V.
const NEED_MA_PER_DV_Q10: u32 = NODE_CAPACITANCE_NF * 1_000 * 1_024 / 10 / DEAD_TIME_NS;

/// Angle of half the dead time at one hertz, in radian: a sine falls by so much of its part in phase with the bridge.
const HALF_DEAD_TIME_RAD_PER_HZ: f64 = PI * DEAD_TIME_NS as f64 * 1e-9;

/// Fall of the current in half the dead time after a turn-off, in milliampere: ½·ω·t of its part in phase with the bridge, which
/// is at its steepest there.
pub fn half_dead_time_fall_ma(f_sw_hz: u32, in_phase_ma: i64) -> i32 {
    const RAD_PER_HZ_Q32: i64 = (HALF_DEAD_TIME_RAD_PER_HZ * 4_294_967_296.0) as i64;
    ((i64::from(f_sw_hz) * RAD_PER_HZ_Q32 * (in_phase_ma >> 4)) >> 28) as i32
}

/// Current that must flow at a turn-off for the node to stand at the other rail when the dead time ends, in milliampere, at a bus
/// voltage in decivolt and with a current that falls by so much in half of it.
///
/// Its mean is that of the middle: I − fall = C·V/t moves the charge; and from I = 2·fall on it does not turn back before the end.
pub fn turn_off_need_ma(bus_dv: u16, fall_ma: i32) -> i32 {
    let charge_ma = ((u32::from(bus_dv) * NEED_MA_PER_DV_Q10) >> 10) as i32;
    charge_ma.max(fall_ma) + fall_ma
}

/// The checks of one frequency.
#[derive(Clone, Debug, Default)]
pub struct SoftLimits {
    /// Capacitor's reactance with the margin, times ampere per volt of a code, in 1/65536.
    reactance_q16: i64,
    /// Fall of the current in half the dead time per sum of its part in phase, in milliampere and 2^-32.
    fall_q32: i32,
    /// |I|²·X_C that is missing over the last blocks, in codes.
    resonance_shortage: i64,
    /// Turn-off current that is missing over the last blocks, of upper and lower switch, in milliampere.
    turn_off_shortage_ma: [i32; 2],
    /// Pairs beyond the limit of current and voltage over the last blocks.
    i_above: u16,
    v_above: u16,
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
            fall_q32: 0,
            resonance_shortage: 0,
            turn_off_shortage_ma: [0; 2],
            i_above: 0,
            v_above: 0,
            hold: 0,
        }
    }

    /// Sets the switching frequency; no limit acts in its first blocks.
    ///
    /// `l_min` resonates with the capacitor there, so X_C is ωL of it: no division.
    pub fn set_frequency(&mut self, f_sw_hz: u32, l_min: PicoHenry) {
        /// Ampere per volt of a code, with the margin, in 1/65536 and per milliohm.
        const PER_MOHM_Q32: u64 = (4_294_967.296 * I_FULL_SCALE_A / V_FULL_SCALE_V * 100.0
            / (100 - SOFT_RESONANCE_PERCENT) as f64) as u64;
        /// 2π in milliohm per hertz and picohenry, 2π·1e-9, in 2^-40.
        const OMEGA_Q40: u64 = 6_908;
        /// Milliampere of the fall per hertz and sum: an amplitude A sums to A·61/2 in 14 bits.
        const FALL_Q44: u64 = (HALF_DEAD_TIME_RAD_PER_HZ * AMPERE_PER_CODE * 2e3
            / (ADC_LOCK_P as f64)
            * (1_u64 << (44 - TABLE_BITS)) as f64) as u64;
        let x_c_mohm =
            (((u64::from(f_sw_hz) * u64::from(l_min.0.unsigned_abs())) >> 8) * OMEGA_Q40) >> 32;
        *self = Self {
            reactance_q16: ((x_c_mohm * PER_MOHM_Q32) >> 16) as i64,
            fall_q32: ((u64::from(f_sw_hz) * FALL_Q44) >> 12) as i32,
            hold: SOFT_HOLD_BLOCKS,
            ..Self::blank()
        };
    }

    /// Suspends all limits until the soft start is over, in which the switches turn off at other samples.
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
        if self.hold > 0 {
            self.hold -= 1;
            return SoftLimitCheck {
                limit: Limit::None,
                turn_off_ma: None,
            };
        }
        let turn_off = (bus_dv >= SOFT_SWITCHING_FROM_DV).then(|| turn_off_ma(pairs));
        // Nothing is out of the ordinary in nearly every block.
        let above = self.i_above | sums.i_above | self.v_above | sums.v_above != 0;
        let limit = if above && is_beyond(&mut self.i_above, sums.i_above) {
            Limit::Current
        } else if above && is_beyond(&mut self.v_above, sums.v_above) {
            Limit::CoilVoltage
        } else if self.is_near_resonance(sums) {
            Limit::Resonance
        } else if turn_off.is_some_and(|turn_off| self.is_too_little(turn_off, sums, bus_dv)) {
            Limit::SoftSwitching
        } else {
            Limit::None
        };
        SoftLimitCheck {
            limit,
            turn_off_ma: turn_off.map(|[upper, lower]| upper.min(lower)),
        }
    }

    /// Im(V·I*) < |I|²·X_C / (1 − margin), in codes, by more than [`SOFT_RESONANCE_SHORTAGE_PERCENT`] over blocks.
    fn is_near_resonance(&mut self, sums: &BlockSums) -> bool {
        let shifted = |z: Complex| (i64::from(z.re >> SHIFT), i64::from(z.im >> SHIFT));
        let ((v_re, v_im), (i_re, i_im)) = (shifted(sums.v), shifted(sums.i));
        let norm = i_re * i_re + i_im * i_im;
        if norm < MIN_NORM {
            self.resonance_shortage = 0;
            return false;
        }
        let shortage = norm * self.reactance_q16 - ((v_im * i_re - v_re * i_im) << 16);
        if shortage <= 0 && self.resonance_shortage == 0 {
            return false;
        }
        let full = norm.max(FULL_NORM) * self.reactance_q16;
        let most = (full >> 7) * (SOFT_RESONANCE_SHORTAGE_PERCENT * 128 / 100);
        // Not `clamp`, which panics where its bounds are the wrong way round.
        self.resonance_shortage = (self.resonance_shortage + shortage).max(0).min(most);
        self.resonance_shortage == most
    }

    /// Adds what either switch's turn-off current lacks.
    fn is_too_little(&mut self, turn_off_ma: [i32; 2], sums: &BlockSums, bus_dv: u16) -> bool {
        // The part in phase with the bridge is −Im.
        let fall_ma = -((i64::from(sums.i.im) * i64::from(self.fall_q32)) >> 32) as i32;
        let need_ma = turn_off_need_ma(bus_dv, fall_ma) * SOFT_TURN_OFF_PERCENT / 100;
        let [upper_ma, lower_ma] = turn_off_ma;
        let [upper_sum, lower_sum] = self.turn_off_shortage_ma;
        if upper_sum | lower_sum == 0 && upper_ma.min(lower_ma) >= need_ma {
            return false;
        }
        let mut acts = false;
        for (sum_ma, ma) in self.turn_off_shortage_ma.iter_mut().zip(turn_off_ma) {
            *sum_ma = (*sum_ma + need_ma - ma).clamp(0, SOFT_TURN_OFF_SHORTAGE_MA);
            acts |= *sum_ma == SOFT_TURN_OFF_SHORTAGE_MA;
        }
        acts
    }
}

/// Adds pairs beyond a limit to those of the last blocks, less one for each block.
#[cold]
#[inline(never)]
fn is_beyond(above: &mut u16, pairs: u16) -> bool {
    let sum = (*above + pairs).min(SOFT_PAIRS);
    *above = sum.saturating_sub(1);
    sum == SOFT_PAIRS
}

/// Current at the turn-offs, in milliampere: out of the node at the upper switch's, into it at the lower one's.
fn turn_off_ma(pairs: &[Pair; ADC_LOCK_P]) -> [i32; 2] {
    /// Milliampere per code, in 1/256.
    const MA_PER_CODE_Q8: i32 = (AMPERE_PER_CODE * 256_000.0) as i32;
    let ma = |code: i32| (code * MA_PER_CODE_Q8) >> 8;
    let [upper, at_lower, after_lower] =
        [AFTER_UPPER, AT_LOWER, AFTER_LOWER].map(|k| i32::from(pairs[k].i));
    [ma(upper), -ma(at_lower + after_lower) / 2]
}

#[cfg(test)]
mod tests;
