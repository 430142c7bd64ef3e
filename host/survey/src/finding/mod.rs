//! Findings about a capture: kinds with numbers, severity and advice.

mod text;

use std::fmt;

use ihd_signal::Remark;
pub use ihd_signal::Severity;
use serde::Serialize;

use crate::clipping::Rails;
use crate::grid;

/// Channel of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Coil voltage.
    Voltage,
    /// Coil current.
    Current,
}

impl Channel {
    /// Symbol of the channel's unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Voltage => "V",
            Self::Current => "A",
        }
    }

    /// Letter of the channel in command-line flags.
    pub fn letter(self) -> &'static str {
        match self {
            Self::Voltage => "v",
            Self::Current => "i",
        }
    }
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Voltage => "voltage",
            Self::Current => "current",
        })
    }
}

/// Finding about a capture, with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "code", rename_all = "snake_case")]
pub enum Finding {
    /// Samples are not finite; the capture is cut there.
    NotFinite {
        /// Number of such samples in both channels.
        samples: usize,
        /// Index of the first.
        first: usize,
    },
    /// Time does not ascend; the capture is cut there.
    TimeNotAscending {
        /// Number of such places.
        times: usize,
        /// Index of the first sample that is not later than the one before.
        sample: usize,
        /// Time of that sample in seconds.
        t_s: f64,
    },
    /// Samples are missing; the capture is cut there.
    Gap {
        /// Number of gaps.
        gaps: usize,
        /// Time of the first gap in seconds.
        t_s: f64,
        /// Length of the longest gap in seconds.
        longest_s: f64,
        /// Number of missing samples in all.
        missing: u64,
    },
    /// Pieces are too short for an estimator and were left out.
    PieceTooShort {
        /// Number of such pieces.
        pieces: usize,
        /// Total length in seconds.
        total_s: f64,
    },
    /// The bridge is off for a while.
    CarrierAbsent {
        /// Beginning in seconds.
        from_s: f64,
        /// End in seconds.
        to_s: f64,
    },
    /// The switching frequency changes.
    FrequencyStep {
        /// Time of the change in seconds.
        t_s: f64,
        /// Frequency before in hertz.
        from_hz: f64,
        /// Frequency after in hertz.
        to_hz: f64,
    },
    /// The switching frequency moves without steps; it is followed.
    FrequencySweep {
        /// Mean frequency in hertz.
        mean_hz: f64,
        /// Half the distance between the smallest and the largest frequency, in hertz.
        deviation_hz: f64,
        /// Repetition rate in hertz, if the motion were a sine.
        rate_hz: f64,
    },
    /// The switching frequency differs from the one specified.
    FrequencyDiffers {
        /// Frequency given by the user or stated by the capture, in hertz.
        #[serde(rename = "told_hz")]
        specified_hz: f64,
        /// Measured frequency in hertz.
        measured_hz: f64,
    },
    /// The frequency found is a harmonic of a lower line in the current.
    HarmonicTaken {
        /// Frequency found in hertz.
        f_hz: f64,
        /// Order of the harmonic.
        order: u32,
        /// Amplitude of the lower line in percent of the harmonic's.
        share_pct: f64,
    },
    /// The mains frequency specified differs from that of the envelope.
    MainsDiffers {
        /// Frequency given by the user or stated by the capture, in hertz.
        #[serde(rename = "told_hz")]
        specified_hz: f64,
        /// Measured frequency in hertz.
        measured_hz: f64,
    },
    /// The zero crossing specified differs from that of the envelope.
    CrossingDiffers {
        /// Time given by the user or stated by the capture, in seconds.
        #[serde(rename = "told_s")]
        specified_s: f64,
        /// Nearest crossing of the envelope, in seconds.
        measured_s: f64,
    },
    /// The mains' phase could not be found.
    MainsUnknown {
        /// Frequency used in hertz.
        assumed_hz: f64,
        /// Origin of this frequency.
        hz_source: grid::MainsSource,
        /// Length of the capture in half-cycles of this frequency.
        half_cycles: f64,
        /// (Largest − smallest)/largest of the voltage's amplitude.
        modulation: f64,
    },
    /// The envelope is that of a mains that no grid has: the time base is wrong.
    TimeBase {
        /// Mains frequency that the envelope shows, in hertz.
        shown_hz: f64,
        /// Sampling rate stated, in hertz.
        rate_hz: f64,
    },
    /// A channel rests at an end of its range.
    Clipping {
        /// Channel that clips.
        channel: Channel,
        /// Number of samples at that level.
        samples: usize,
        /// Magnitude of the level, in the channel's unit: of both ends the larger.
        level: f64,
        /// Levels at both ends.
        #[serde(skip)]
        rails: Rails,
    },
    /// A channel has a constant offset: neither the coil's voltage nor its current has a mean.
    Offset {
        /// Channel with the offset.
        channel: Channel,
        /// Mean in the channel's unit.
        mean: f64,
        /// Mean in percent of the rms value.
        of_rms_pct: f64,
    },
    /// A value exceeds that of a hob's coil: a probe's factor is wrong.
    Implausible {
        /// Channel with the value.
        channel: Channel,
        /// Largest magnitude of its samples, in the channel's unit.
        peak: f64,
        /// Limit in the channel's unit.
        most: f64,
    },
    /// A channel is noisy.
    Noisy {
        /// Channel with the noise.
        channel: Channel,
        /// Signal-to-noise ratio in decibel.
        snr_db: f64,
    },
    /// A switching period has few samples.
    CoarselySampled {
        /// Samples per switching period.
        samples_per_period: f64,
    },
    /// Harmonics of the voltage's edges fall on the fundamental.
    Aliasing {
        /// Samples per switching period.
        samples_per_period: f64,
        /// Lowest order that falls on the fundamental.
        order: u32,
        /// Expected error of R in percent.
        r_pct: f64,
        /// Expected error of L in percent.
        l_pct: f64,
    },
    /// Voltage and current are exchanged.
    Swapped {
        /// `true` if the user has exchanged them.
        by_user: bool,
    },
    /// One probe is reversed: R and L are negative.
    Inverted {
        /// R as measured, in ohm.
        r_ohm: f64,
        /// `true` if the user has changed the sign of one channel.
        by_user: bool,
    },
    /// R is negative while L is not: the channels are not simultaneous.
    NegativeResistance {
        /// R as measured, in ohm.
        r_ohm: f64,
        /// Skew in seconds that would make R zero, the least there must be.
        skew_s: f64,
    },
    /// A channel does not contain the switching frequency.
    Dead {
        /// Channel without the switching frequency.
        channel: Channel,
    },
}

/// Least amplitude of the current's line below f_sw, in percent of that at f_sw: a neighbouring hob's is below 5 %.
pub(crate) const MIN_SUBHARMONIC_PCT: f64 = 10.0;

/// Error of R in percent above which aliasing is a warning: half the accuracy of the firmware's estimator
/// (docs/accuracy.md).
const ALIASING_WARNING_PCT: f64 = 1.0;

impl Finding {
    /// Effect on R and L.
    pub fn severity(&self) -> Severity {
        match self {
            Self::FrequencyStep { .. }
            | Self::FrequencySweep { .. }
            | Self::CarrierAbsent { .. } => Severity::Info,
            Self::Aliasing { r_pct, .. } if *r_pct < ALIASING_WARNING_PCT => Severity::Info,
            Self::PieceTooShort { .. }
            | Self::FrequencyDiffers { .. }
            | Self::MainsDiffers { .. }
            | Self::CrossingDiffers { .. }
            | Self::MainsUnknown { .. }
            | Self::Offset { .. }
            | Self::Implausible { .. }
            | Self::Noisy { .. }
            | Self::CoarselySampled { .. }
            | Self::Gap { .. }
            | Self::NotFinite { .. }
            | Self::Aliasing { .. } => Severity::Warning,
            Self::TimeBase { shown_hz, .. } if grid::is_possible(*shown_hz) => Severity::Warning,
            Self::TimeNotAscending { .. }
            | Self::TimeBase { .. }
            | Self::HarmonicTaken { .. }
            | Self::Clipping { .. }
            | Self::Swapped { .. }
            | Self::Inverted { .. }
            | Self::NegativeResistance { .. }
            | Self::Dead { .. } => Severity::Error,
        }
    }
}

impl Finding {
    /// Code of the finding in `snake_case`, as in JSON.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "not_finite",
            Self::TimeNotAscending { .. } => "time_not_ascending",
            Self::Gap { .. } => "gap",
            Self::PieceTooShort { .. } => "piece_too_short",
            Self::CarrierAbsent { .. } => "carrier_absent",
            Self::FrequencyStep { .. } => "frequency_step",
            Self::FrequencySweep { .. } => "frequency_sweep",
            Self::FrequencyDiffers { .. } => "frequency_differs",
            Self::HarmonicTaken { .. } => "harmonic_taken",
            Self::MainsDiffers { .. } => "mains_differs",
            Self::CrossingDiffers { .. } => "crossing_differs",
            Self::MainsUnknown { .. } => "mains_unknown",
            Self::TimeBase { .. } => "time_base",
            Self::Clipping { .. } => "clipping",
            Self::Offset { .. } => "offset",
            Self::Implausible { .. } => "implausible",
            Self::Noisy { .. } => "noisy",
            Self::CoarselySampled { .. } => "coarsely_sampled",
            Self::Aliasing { .. } => "aliasing",
            Self::Swapped { .. } => "swapped",
            Self::Inverted { .. } => "inverted",
            Self::NegativeResistance { .. } => "negative_resistance",
            Self::Dead { .. } => "dead",
        }
    }

    /// Value that was judged; `None` if there is no single one.
    fn value(&self) -> Option<f64> {
        Some(match self {
            Self::NotFinite { samples, .. } | Self::Clipping { samples, .. } => *samples as f64,
            Self::TimeNotAscending { times, .. } => *times as f64,
            Self::Gap { longest_s, .. } => *longest_s,
            Self::PieceTooShort { total_s, .. } => *total_s,
            Self::CarrierAbsent { from_s, to_s } => to_s - from_s,
            Self::FrequencyStep { to_hz, .. } => *to_hz,
            Self::FrequencySweep { deviation_hz, .. } => *deviation_hz,
            Self::FrequencyDiffers { measured_hz, .. } | Self::MainsDiffers { measured_hz, .. } => {
                *measured_hz
            }
            Self::CrossingDiffers { measured_s, .. } => *measured_s,
            Self::HarmonicTaken { share_pct, .. } => *share_pct,
            Self::MainsUnknown { half_cycles, .. } => *half_cycles,
            Self::TimeBase { shown_hz, .. } => *shown_hz,
            Self::Offset { mean, .. } => *mean,
            Self::Implausible { peak, .. } => *peak,
            Self::Noisy { snr_db, .. } => *snr_db,
            Self::CoarselySampled { samples_per_period } => *samples_per_period,
            Self::Aliasing { r_pct, .. } => *r_pct,
            Self::Inverted { r_ohm, .. } | Self::NegativeResistance { r_ohm, .. } => *r_ohm,
            Self::Swapped { .. } | Self::Dead { .. } => return None,
        })
    }

    /// Limit of the value, in the same unit; `None` if there is none.
    fn limit(&self) -> Option<f64> {
        Some(match self {
            Self::FrequencyDiffers { specified_hz, .. }
            | Self::MainsDiffers { specified_hz, .. } => *specified_hz,
            Self::CrossingDiffers { specified_s, .. } => *specified_s,
            Self::HarmonicTaken { .. } => MIN_SUBHARMONIC_PCT,
            Self::Implausible { most, .. } => *most,
            Self::CoarselySampled { .. } => crate::COARSE_SAMPLES_PER_PERIOD,
            Self::Aliasing { .. } => ALIASING_WARNING_PCT,
            _ => return None,
        })
    }

    /// Converts the finding to a remark, as shown by `ihd identify` and the gate beside an estimate.
    pub fn remark(&self) -> Remark {
        Remark {
            code: self.code(),
            severity: self.severity(),
            text: self.to_string(),
            value: self.value().filter(|x| x.is_finite()),
            limit: self.limit().filter(|x| x.is_finite()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_has_one_name_in_json_and_as_a_remark() {
        for finding in [
            Finding::Gap {
                gaps: 1,
                t_s: 0.0,
                longest_s: 1e-3,
                missing: 7,
            },
            Finding::Dead {
                channel: Channel::Current,
            },
            Finding::CoarselySampled {
                samples_per_period: 9.0,
            },
        ] {
            let json = serde_json::to_value(&finding).unwrap();
            assert_eq!(json["code"], finding.code());
            assert_eq!(finding.remark().code, finding.code());
        }
    }

    #[test]
    fn the_text_on_clipping_names_every_level_at_which_the_channel_rests() {
        let text = |low: Option<f64>, high: Option<f64>| {
            let rails = Rails { low, high };
            let finding = Finding::Clipping {
                channel: Channel::Current,
                samples: 9,
                level: rails.level(),
                rails,
            };
            finding.to_string()
        };
        for (low, high, named) in [
            (Some(-85.0), Some(75.0), "clipped at -85.0000 and 75.0000 A"),
            (Some(-85.0), None, "clipped at -85.0000 A"),
            (None, Some(75.0), "clipped at 75.0000 A"),
        ] {
            assert!(text(low, high).contains(named), "{}", text(low, high));
        }
    }
}
