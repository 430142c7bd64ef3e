//! Errors of a survey.

/// Reason why a capture cannot be surveyed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SurveyError {
    /// Voltage, current and stamps differ in length.
    #[error(
        "{name}: {v} voltage samples, {i} current samples and {stamps} times: they must be as many"
    )]
    Lengths {
        /// Name of the capture.
        name: String,
        /// Number of voltage samples.
        v: usize,
        /// Number of current samples.
        i: usize,
        /// Number of times; that of the voltage samples if the time base is even.
        stamps: usize,
    },
    /// The capture has no samples.
    #[error("{name} holds no samples")]
    Empty {
        /// Name of the capture.
        name: String,
    },
    /// The time base is impossible.
    #[error(
        "{name}: the time from sample to sample is {dt_s} s, the first sample's {t0_s} s; the step must be a finite \
         number above zero, and the start near enough to zero to tell the samples apart"
    )]
    TimeStep {
        /// Name of the capture.
        name: String,
        /// Time of the first sample in seconds.
        t0_s: f64,
        /// Time from sample to sample in seconds.
        dt_s: f64,
    },
    /// Too few samples without a gap.
    #[error(
        "{name}: the longest stretch without a gap has {samples} samples ({ms:.3} ms), but {needed:.3} ms \
         are needed: take a longer capture"
    )]
    TooShort {
        /// Name of the capture.
        name: String,
        /// Samples of the longest run.
        samples: usize,
        /// Length of the longest run in milliseconds.
        ms: f64,
        /// Length that is needed, in milliseconds.
        needed: f64,
    },
    /// The sampling rate is too low for any switching frequency.
    #[error(
        "{name}: sampled at {rate_hz:.0} Hz, which cannot show a switching frequency of {least_hz:.0} Hz: \
         sample at more than twice of it, or give --input rate=HZ where the file's time is in another unit than seconds"
    )]
    TooSlow {
        /// Name of the capture.
        name: String,
        /// Sampling rate in hertz.
        rate_hz: f64,
        /// Smallest switching frequency of the search, in hertz.
        least_hz: f64,
    },
    /// No switching frequency was found.
    #[error(
        "{name}: no switching frequency from {from_khz:.1} to {to_khz:.1} kHz in {what}: is the inverter \
         running, are the probes on, are the right columns chosen?"
    )]
    NoCarrier {
        /// Name of the capture.
        name: String,
        /// Lower end of the search in kilohertz.
        from_khz: f64,
        /// Upper end of the search in kilohertz.
        to_khz: f64,
        /// Signal that was searched.
        what: &'static str,
    },
    /// The switching frequency differs from the one given.
    #[error(
        "{name}: no switching frequency near the {specified_khz:.2} kHz given; {found_khz:.2} kHz is there: leave \
         the frequency out or correct it"
    )]
    NotAtHint {
        /// Name of the capture.
        name: String,
        /// Frequency given, in kilohertz.
        specified_khz: f64,
        /// Frequency found, in kilohertz.
        found_khz: f64,
    },
}
