//! Codes of an analogue-to-digital converter.

/// Rounds a value in units of one code to the nearest code of a converter of 8 to 16 bits; saturates. NaN gives the lower rail,
/// so that it is counted as saturated.
#[inline]
pub fn code(codes: f64, bits: u32) -> i16 {
    let half_range = f64::from(1u32 << (bits - 1));
    if codes.is_nan() {
        return -half_range as i16;
    }
    // The conversion truncates. A half of the last digit less than a half: a sum that is rounded up would reach the next code.
    let half = 0.5f64.next_down().copysign(codes);
    (codes.clamp(-half_range, half_range - 1.0) + half) as i16
}

#[cfg(test)]
mod tests {
    use super::code;

    #[test]
    fn codes_round_saturate_and_take_no_number_for_the_lower_rail() {
        assert_eq!((code(1.4, 12), code(-1.6, 12)), (1, -2));
        assert_eq!((code(1e9, 16), code(-1e9, 8)), (32767, -128));
        assert_eq!(code(f64::NAN, 12), -2048);
        for n in -40_000..40_000 {
            let half = f64::from(n) * 0.5;
            for codes in [half.next_down(), half, half.next_up()] {
                let expected = codes.round().clamp(-8192.0, 8191.0) as i16;
                assert_eq!(code(codes, 14), expected, "{codes:?}");
            }
        }
    }
}
