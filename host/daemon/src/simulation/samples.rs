//! Samples of the windows of a script.

use std::f64::consts::{PI, TAU};

use ihd_shared::sampling::{Pair, Scales, f_adc_hz};
use ihd_signal::{Load, current_transformer};

/// Switching frequency in hertz.
pub const F_SW_HZ: u32 = 45_000;

/// Time of the first pair after the zero crossing, in seconds.
const FIRST_S: f64 = 1e-6;

/// Duration of a half-cycle in seconds.
const HALF_S: f64 = 10e-3;

/// Amplitude of the current at its crest, in ampere.
const CREST_A: f64 = 35.0;

/// Load of the windows made by [`with_load`].
pub const LOAD: Load = Load {
    r_ohm: 4.0,
    l_h: 50e-6,
};

/// Returns the pairs of one block from which no load can be identified.
pub fn without_load() -> Vec<u8> {
    let pair = |k: usize| {
        let phase = k as f64 * TAU * 3.0 / 61.0;
        let [v, i] = [1_000.0 * phase.sin(), 600.0 * (phase - 0.7).sin()];
        pair(v, i)
    };
    (0..61).flat_map(pair).collect()
}

/// Returns the pairs of a half-cycle with [`LOAD`]: v = R·i + L·di/dt, the current behind the board's transformer.
pub fn with_load() -> Vec<u8> {
    let scales = Scales::OF_THIS_BUILD;
    let (omega, mains) = (TAU * f64::from(F_SW_HZ), PI / HALF_S);
    let rate_hz = f_adc_hz(F_SW_HZ);
    // Whole blocks, as a device records them.
    let blocks = ((HALF_S - FIRST_S) * rate_hz / 61.0) as usize;
    let at = |k: usize| {
        let t_s = FIRST_S + k as f64 / rate_hz;
        let (envelope, slope) = ((mains * t_s).sin(), mains * (mains * t_s).cos());
        let i_a = CREST_A * envelope * (omega * t_s).sin();
        let di_a_s =
            CREST_A * (slope * (omega * t_s).sin() + envelope * omega * (omega * t_s).cos());
        (LOAD.r_ohm * i_a + LOAD.l_h * di_a_s, i_a)
    };
    let (v_v, mut i_a): (Vec<f64>, Vec<f64>) = (0..61 * blocks).map(at).unzip();
    current_transformer::droop(&mut i_a, rate_hz.recip(), current_transformer::BOARD_TAU_S);
    let code = |(v_v, i_a)| pair(v_v / scales.volt_per_code(), i_a / scales.ampere_per_code());
    v_v.into_iter().zip(i_a).flat_map(code).collect()
}

fn pair(v_code: f64, i_code: f64) -> [u8; 4] {
    let [v, i] = [v_code, i_code].map(|x| (x.round() as i16).to_le_bytes());
    Pair::from_le_bytes([v[0], v[1], i[0], i[1]]).to_le_bytes()
}
