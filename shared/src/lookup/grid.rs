//! The lookup's axes: uniform in ln f and in ln(1 + I / 5 A).
//!
//! R rises and L falls roughly as a power of f, and both fall roughly as 1/(1 + I/I0): on
//! logarithmic axes a straight line between two knots stays within 0.3 % of such laws.

/// Frequencies of the grid.
pub const FREQUENCIES: usize = 8;

/// Currents of the grid.
pub const CURRENTS: usize = 17;

/// Cells of the grid.
pub const CELLS: usize = FREQUENCIES * CURRENTS;

/// Lowest frequency of the grid, in hertz.
pub const F_MIN_HZ: u32 = 30_000;

/// The current that sets the axis' bend, in milliampere.
pub const I_BEND_MA: u32 = 5_000;

/// Highest current of the grid, in milliampere.
pub const I_MAX_MA: u32 = 80_000;

/// One step of a coordinate: coordinates are knot numbers in 16-bit fixed point.
pub const ONE: u64 = 1 << 16;

/// (FREQUENCIES − 1) / log2(F_MAX / F_MIN), 20-bit fixed point.
const STEPS_PER_OCTAVE_F_Q20: u64 = 5_187_164;

/// (CURRENTS − 1) / log2(1 + I_MAX / I_BEND), 20-bit fixed point.
const STEPS_PER_OCTAVE_I_Q20: u64 = 4_104_555;

/// log2(x) in 20-bit fixed point, rounded down; 0 for x < 2.
///
/// The classic bit-by-bit method: square the mantissa, and the next bit of the logarithm is
/// whether it passed 2. 20 multiplications, no table, exact to the last bit but truncation.
pub const fn log2_q20(x: u32) -> u64 {
    if x < 2 {
        return 0;
    }
    let whole = 31 - x.leading_zeros();
    let mut mantissa = (x as u64) << (31 - whole);
    let mut fraction = 0u64;
    let mut bit = 0;
    while bit < 20 {
        mantissa = (mantissa * mantissa) >> 31;
        fraction <<= 1;
        if mantissa >> 32 != 0 {
            mantissa >>= 1;
            fraction |= 1;
        }
        bit += 1;
    }
    ((whole as u64) << 20) | fraction
}

const LOG2_F_MIN_Q20: u64 = log2_q20(F_MIN_HZ);
const LOG2_I_BEND_Q20: u64 = log2_q20(I_BEND_MA);

fn coordinate(x: u32, log2_base_q20: u64, steps_per_octave_q20: u64, knots: usize) -> u64 {
    let octaves = log2_q20(x).saturating_sub(log2_base_q20);
    ((octaves * steps_per_octave_q20) >> 24).min((knots as u64 - 1) * ONE)
}

/// Coordinate of a switching frequency, clamped to the grid.
pub fn frequency_coordinate(f_sw_hz: u32) -> u64 {
    coordinate(f_sw_hz, LOG2_F_MIN_Q20, STEPS_PER_OCTAVE_F_Q20, FREQUENCIES)
}

/// Coordinate of a current amplitude, clamped to the grid.
pub fn current_coordinate(i_ma: u32) -> u64 {
    coordinate(
        i_ma.saturating_add(I_BEND_MA),
        LOG2_I_BEND_Q20,
        STEPS_PER_OCTAVE_I_Q20,
        CURRENTS,
    )
}

/// Lower knot of a coordinate and the weight of the upper one, for an axis of `knots` knots.
pub fn split(coordinate: u64, knots: usize) -> (usize, u64) {
    let k = ((coordinate >> 16) as usize).min(knots - 2);
    (k, coordinate - k as u64 * ONE)
}

/// Frequency of a knot, in hertz. For the host; the firmware never needs it.
pub fn frequency_hz(knot: usize) -> f64 {
    FREQUENCY_KNOTS_HZ[knot.min(FREQUENCIES - 1)]
}

/// Current of a knot, in ampere. For the host; the firmware never needs it.
pub fn current_a(knot: usize) -> f64 {
    CURRENT_KNOTS_A[knot.min(CURRENTS - 1)]
}

/// Frequency of each knot, in hertz: 30 kHz · (8/3)^(k/7); tests compare with the formula.
pub const FREQUENCY_KNOTS_HZ: [f64; FREQUENCIES] = [
    30000.0,
    34512.302213634364,
    39703.30013617438,
    45675.07643927603,
    52545.06805677151,
    60448.37562037613,
    69540.42025779028,
    80000.0,
];

/// Current of each knot, in ampere: 5 A · (17^(k/16) − 1); tests compare with the formula.
pub const CURRENT_KNOTS_A: [f64; CURRENTS] = [
    0.0,
    0.9686080719195012,
    2.124856463236524,
    3.5050951595482682,
    5.152715924344653,
    7.119516443589831,
    9.467328734594275,
    12.269963012882467,
    15.615528128088304,
    19.60920151843827,
    24.37653576528886,
    30.067405698747002,
    36.860720142963444,
    44.970046428330974,
    54.6503244932657,
    66.20588165262463,
    80.0,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log2_is_exact_to_its_last_bits() {
        for x in (1..200_000u32).step_by(37).chain([u32::MAX, 1 << 31, 3]) {
            let exact = f64::from(x).log2() * 1_048_576.0;
            assert!((log2_q20(x) as f64 - exact).abs() < 2.0, "log2({x})");
        }
    }

    #[test]
    fn constants_follow_their_formulas() {
        let f = 7.0 / (80f64 / 30.0).log2() * 1_048_576.0;
        let i = 16.0 / 17f64.log2() * 1_048_576.0;
        assert_eq!(STEPS_PER_OCTAVE_F_Q20, f.round() as u64);
        assert_eq!(STEPS_PER_OCTAVE_I_Q20, i.round() as u64);
        for k in 0..FREQUENCIES {
            let knot = 30e3 * (8f64 / 3.0).powf(k as f64 / 7.0);
            assert!((frequency_hz(k) - knot).abs() < 1e-6);
        }
        for k in 0..CURRENTS {
            let knot = 5.0 * (17f64.powf(k as f64 / 16.0) - 1.0);
            assert!((current_a(k) - knot).abs() < 1e-9);
        }
    }

    #[test]
    fn coordinates_clamp_at_the_edges() {
        assert_eq!(frequency_coordinate(1_000), 0);
        assert_eq!(frequency_coordinate(u32::MAX), 7 * ONE);
        assert_eq!(current_coordinate(0), 0);
        assert_eq!(current_coordinate(u32::MAX), 16 * ONE);
        assert_eq!(split(7 * ONE, FREQUENCIES), (6, ONE));
    }
}
