//! Comparator on the coil current, with the filter of HRTIM's fault input behind it.

use ihd_firmware::drive::pwm::CORE_HZ;
use ihd_shared::board::TRIP_DELAY_NS;

/// Duration from which a pulse trips, in seconds, as the program sets up the chip: six samples in a row, one every 8 cycles
/// of the processor, and up to one more period before the first.
pub const FAULT_FILTER_S: f64 = 7.0 * 8.0 / CORE_HZ as f64;

/// Time besides the filters from the pin above its level to an open switch, in seconds (docs/board.md, "Current and trip").
pub const TRIP_DELAY_S: f64 = TRIP_DELAY_NS as f64 * 1e-9;

/// Comparator: its input trips once it has been above its level for a while.
#[derive(Clone, Copy, Debug, Default)]
pub struct FilteredComparator {
    /// Input less level at the end of the last step.
    excess: f64,
    above_s: f64,
}

impl FilteredComparator {
    /// Time for which the input has been above the level, in seconds.
    pub fn above_s(&self) -> f64 {
        self.above_s
    }

    /// Advances by `dt_s` to an input that exceeds its level by `excess`, linear in between; returns by how many seconds before the
    /// end of the step it had lasted for `filter_s`, from then on and while it lasts.
    #[inline]
    pub fn advance(&mut self, excess: f64, filter_s: f64, dt_s: f64) -> Option<f64> {
        let before = std::mem::replace(&mut self.excess, excess);
        if before <= 0.0 && excess <= 0.0 {
            return None;
        }
        // Part of the step in which it is above.
        let part_s = match (before > 0.0, excess > 0.0) {
            (true, true) => dt_s,
            (false, _) => dt_s * excess / (excess - before),
            (true, false) => dt_s * before / (before - excess),
        };
        let lasted_s = self.above_s + part_s;
        let ended_s = match excess > 0.0 {
            true => 0.0,
            false => dt_s - part_s,
        };
        self.above_s = match excess > 0.0 {
            true => lasted_s,
            false => 0.0,
        };
        (lasted_s >= filter_s).then_some(ended_s + lasted_s - filter_s)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::low_pass::LowPass;
    use ihd_shared::sampling::ANTI_ALIAS_HZ;

    /// Returns `true` if a sine of this amplitude trips at 76.07 A behind the anti-alias filter.
    fn trips(f_hz: f64, amplitude_a: f64) -> bool {
        let dt_s = 1.0 / (f_hz * 244.0);
        let mut filter = LowPass::settled(f64::from(ANTI_ALIAS_HZ), 0.0);
        let mut comparator = FilteredComparator::default();
        (0..5 * 244).any(|n| {
            let i_a = amplitude_a * (TAU * f_hz * f64::from(n) * dt_s).sin();
            let excess_a = filter.advance(i_a, dt_s) - 76.07;
            comparator.advance(excess_a, FAULT_FILTER_S, dt_s).is_some()
        })
    }

    /// By ngspice, with 316 Ω, 1 nF and a pulse of 235 to 330 ns, 76.3 A at 34 kHz, 76.5 A at 47 kHz and 77.2 to 77.3 A at 80 kHz.
    #[test]
    fn the_smallest_sine_that_trips_is_ngspices() {
        for (f_hz, expected_a) in [(34e3, 76.3), (47e3, 76.55), (80e3, 77.27)] {
            assert!(!trips(f_hz, expected_a - 0.12), "{f_hz}");
            assert!(trips(f_hz, expected_a + 0.12), "{f_hz}");
        }
    }

    /// Pulse of 400 ns on steps of 100 ns, off their grid: it had lasted for 330 ns 70 ns before its end.
    #[test]
    fn a_pulse_trips_when_it_has_lasted_and_a_shorter_one_does_not() {
        let mut comparator = FilteredComparator::default();
        let mut trip = |excess: &[f64]| {
            let found = excess
                .iter()
                .map(|&excess| comparator.advance(excess, 330e-9, 100e-9))
                .collect::<Vec<_>>();
            found.into_iter().flatten().next()
        };
        assert_eq!(trip(&[-1.0, -1.0, 1.0, 1.0, 1.0, -1.0]), None);
        let before_end_s = trip(&[-1.0, 1.0, 1.0, 1.0, 1.0, -1.0]).unwrap();
        assert!((before_end_s - 20e-9).abs() < 1e-15, "{before_end_s}");
    }
}
