//! Values that a user states about a capture, and the range of each.

use crate::mains::SPECIFIED_HZ;

/// Values given by the user; they override those stored in the capture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hints {
    /// Switching frequency in hertz, to 10 %.
    pub f_sw_hz: Option<f64>,
    /// Mains frequency in hertz.
    pub mains_hz: Option<f64>,
    /// Time of a mains zero crossing in seconds.
    pub zero_crossing_s: Option<f64>,
    /// `true` if the user has exchanged the channels of the file.
    pub swapped: bool,
    /// `true` if the user has changed the sign of one channel.
    pub inverted: bool,
}

/// Range of a number that a user states: values outside would be ignored, or taken for a fault of the capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatedRange {
    /// Switching frequency in hertz.
    SwitchingHz,
    /// Mains frequency in hertz.
    MainsHz,
    /// Time in seconds.
    TimeS,
    /// Sampling rate in hertz.
    AboveZero,
    /// Capacitance of a hob's resonance capacitor in farad.
    CapacitanceF,
    /// Ratio of a probe.
    ProbeRatio,
}

/// Error for a number outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be a number {}", match self.0 {
    StatedRange::SwitchingHz => "of 1 kHz to 1 MHz",
    StatedRange::MainsHz => "of 1 Hz to 1 kHz",
    StatedRange::TimeS => "that is finite",
    StatedRange::AboveZero => "above zero",
    StatedRange::CapacitanceF => "of 10 nF to 100 µF, in farad (1080 nF is 1.08e-6)",
    StatedRange::ProbeRatio => "other than zero",
})]
pub struct OutOfRange(StatedRange);

impl StatedRange {
    /// Returns the number if it lies within the range.
    ///
    /// # Errors
    /// [`OutOfRange`], as for each number that is not finite.
    pub fn check(self, x: f64) -> Result<f64, OutOfRange> {
        let is_within = match self {
            Self::SwitchingHz => (1e3..=1e6).contains(&x),
            Self::MainsHz => SPECIFIED_HZ.contains(&x),
            Self::TimeS => true,
            Self::AboveZero => x >= f64::MIN_POSITIVE,
            Self::CapacitanceF => (10e-9..=100e-6).contains(&x),
            Self::ProbeRatio => x != 0.0,
        };
        (x.is_finite() && is_within)
            .then_some(x)
            .ok_or(OutOfRange(self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1.08 for 1.08 µF, and 1080 for 1080 nF.
    #[test]
    fn a_capacitance_without_its_prefix_is_refused() {
        for x in [1.08, 1080.0, 1e-12, 0.0, f64::NAN] {
            let refused = StatedRange::CapacitanceF.check(x).unwrap_err();
            assert!(refused.to_string().contains("in farad"), "{x}: {refused}");
        }
        assert_eq!(StatedRange::CapacitanceF.check(1.08e-6), Ok(1.08e-6));
    }
}
