//! The sampling grid: both ADCs are triggered together, at a rate locked to the PWM.
//!
//! f_adc = f_sw · p / q with p = 61, q = 3. The ratio is not an integer on purpose: with an
//! integer number of samples per switching period the harmonics of the voltage edges alias onto
//! the fundamental. With 61 samples over three periods, harmonic h falls on the fundamental only
//! for h ≡ ±1 (mod 61): h = 60 and 62 are even, which a 50 % half-bridge does not produce, and
//! the first odd ones are 121 and 123.

/// Samples per block, the numerator p of f_adc / f_sw. One block spans [`ADC_LOCK_Q`] periods.
pub const ADC_LOCK_P: usize = 61;

/// Switching periods per block, the denominator q of f_adc / f_sw.
pub const ADC_LOCK_Q: u32 = 3;

pub use crate::board::{
    ANTI_ALIAS_HZ, COIL_CURRENT_FULL_SCALE_MA as I_FULL_SCALE_MA,
    COIL_VOLTAGE_FULL_SCALE_MV as V_FULL_SCALE_MV, CURRENT_TRANSFORMER_TAU_US,
};

/// Half the input range of the voltage channel, in volt.
pub const V_FULL_SCALE_V: f64 = V_FULL_SCALE_MV as f64 / 1e3;

/// Half the input range of the current channel, in ampere.
pub const I_FULL_SCALE_A: f64 = I_FULL_SCALE_MA as f64 / 1e3;

/// Bits of a code.
pub const CODE_BITS: u8 = 12;

/// Half the number of codes of the ADC.
pub const CODE_HALF_RANGE: i16 = 1 << (CODE_BITS - 1);

/// Magnitude of a code from which on a sample is saturated: the end of the range, 2047, as it reads at the lowest supply that
/// is corrected (firmware/src/sense/supply.rs), 1997, less what rounding may take.
pub const SATURATED_FROM: i16 = 1_990;

/// Largest code.
pub const CODE_MAX: i16 = CODE_HALF_RANGE - 1;

/// Smallest code.
pub const CODE_MIN: i16 = -CODE_HALF_RANGE;

/// Volt per code of the voltage channel of this build.
pub const VOLT_PER_CODE: f64 = V_FULL_SCALE_V / CODE_HALF_RANGE as f64;

/// Ampere per code of the current channel of this build.
pub const AMPERE_PER_CODE: f64 = I_FULL_SCALE_A / CODE_HALF_RANGE as f64;

/// Scales of the codes of a pair's two channels. They travel with the data: boards and their
/// recordings differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scales {
    /// Half the input range of the voltage channel, in millivolt.
    pub v_full_scale_mv: u32,
    /// Half the input range of the current channel, in milliampere.
    pub i_full_scale_ma: u32,
}

impl Scales {
    /// Those that this build of the firmware reads by.
    pub const OF_THIS_BUILD: Self = Self {
        v_full_scale_mv: V_FULL_SCALE_MV,
        i_full_scale_ma: I_FULL_SCALE_MA,
    };

    /// Half the input range of the voltage channel, in volt.
    pub fn v_full_scale_v(self) -> f64 {
        f64::from(self.v_full_scale_mv) / 1e3
    }

    /// Half the input range of the current channel, in ampere.
    pub fn i_full_scale_a(self) -> f64 {
        f64::from(self.i_full_scale_ma) / 1e3
    }

    /// Volt per code of the voltage channel.
    pub fn volt_per_code(self) -> f64 {
        self.v_full_scale_v() / f64::from(CODE_HALF_RANGE)
    }

    /// Ampere per code of the current channel.
    pub fn ampere_per_code(self) -> f64 {
        self.i_full_scale_a() / f64::from(CODE_HALF_RANGE)
    }
}

/// For people: "±640.4 V, ±80.1 A".
impl core::fmt::Display for Scales {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (v, i) = (self.v_full_scale_v(), self.i_full_scale_a());
        write!(f, "±{v:.1} V, ±{i:.1} A")
    }
}

/// Sampling rate in hertz at a switching frequency in hertz.
pub fn f_adc_hz(f_sw_hz: u32) -> f64 {
    f64::from(f_sw_hz) * ADC_LOCK_P as f64 / f64::from(ADC_LOCK_Q)
}

/// Duration of one block of [`ADC_LOCK_P`] pairs, in nanoseconds, rounded to nearest.
pub const fn block_ns(f_sw_hz: u32) -> u32 {
    // In 32 bit, as the sampling path divides here: from 2^31 on it is one either way.
    let f = match f_sw_hz {
        0 => 1,
        f if f > 1 << 31 => 1 << 31,
        f => f,
    };
    (ADC_LOCK_Q * 1_000_000_000 + f / 2) / f
}

/// One simultaneous sample of coil voltage and coil current, as signed ADC codes.
/// Aligned so that one load brings both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(4))]
pub struct Pair {
    /// Voltage code, [`Scales::volt_per_code`] each.
    pub v: i16,
    /// Current code, [`Scales::ampere_per_code`] each.
    pub i: i16,
}

impl Pair {
    /// Returns `true` if either channel stands at the end of its range.
    pub fn is_saturated(self) -> bool {
        let is_at_end = |code: i16| code.unsigned_abs() >= SATURATED_FROM.unsigned_abs();
        is_at_end(self.v) || is_at_end(self.i)
    }

    /// Each pair of a block as one word, v in the low half: what a 32-bit multiply-accumulate of
    /// halves wants. Both ends are little-endian.
    pub fn words(block: &[Self; ADC_LOCK_P]) -> &[u32; ADC_LOCK_P] {
        const { assert!(cfg!(target_endian = "little")) };
        bytemuck::must_cast_ref(block)
    }

    /// Inverse of [`Pair::words`].
    pub fn of_words(words: &[u32; ADC_LOCK_P]) -> &[Self; ADC_LOCK_P] {
        const { assert!(cfg!(target_endian = "little")) };
        bytemuck::must_cast_ref(words)
    }

    /// The layout on the wire and in files: v then i, little-endian 16 bit.
    pub fn to_le_bytes(self) -> [u8; 4] {
        let [v0, v1] = self.v.to_le_bytes();
        let [i0, i1] = self.i.to_le_bytes();
        [v0, v1, i0, i1]
    }

    /// Inverse of [`Pair::to_le_bytes`].
    pub fn from_le_bytes(b: [u8; 4]) -> Self {
        Self {
            v: i16::from_le_bytes([b[0], b[1]]),
            i: i16::from_le_bytes([b[2], b[3]]),
        }
    }
}
