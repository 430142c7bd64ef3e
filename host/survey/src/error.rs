//! Why a capture cannot be surveyed.

/// Why there is nothing to survey.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SurveyError {
    /// Voltage, current and stamps do not have one length.
    #[error(
        "{name}: {v} voltage samples, {i} current samples and {stamps} times: they must be as many"
    )]
    Lengths {
        /// The capture.
        name: String,
        /// Samples of the voltage.
        v: usize,
        /// Samples of the current.
        i: usize,
        /// Times; as many as voltages where the time base is even.
        stamps: usize,
    },
    /// No samples at all.
    #[error("{name} holds no samples")]
    Empty {
        /// The capture.
        name: String,
    },
    /// Times that cannot be.
    #[error(
        "{name}: the time from sample to sample is {dt_s} s, the first sample's {t0_s} s; the step must be a finite \
         number above zero, and the start near enough to zero to tell the samples apart"
    )]
    TimeStep {
        /// The capture.
        name: String,
        /// Time of the first sample in seconds.
        t0_s: f64,
        /// The step in seconds.
        dt_s: f64,
    },
    /// Too few samples in a row.
    #[error(
        "{name}: the longest stretch without a gap has {samples} samples ({ms:.3} ms), but {needed:.3} ms \
         are needed: take a longer capture"
    )]
    TooShort {
        /// The capture.
        name: String,
        /// Samples of the longest run.
        samples: usize,
        /// Its length in milliseconds.
        ms: f64,
        /// What is needed, in milliseconds.
        needed: f64,
    },
    /// The rate cannot show any switching frequency.
    #[error(
        "{name}: sampled at {rate_hz:.0} Hz, which cannot show a switching frequency of {least_hz:.0} Hz: \
         sample at more than twice of it"
    )]
    TooSlow {
        /// The capture.
        name: String,
        /// Sampling rate in hertz.
        rate_hz: f64,
        /// The smallest switching frequency that would be looked for, in hertz.
        least_hz: f64,
    },
    /// No switching frequency.
    #[error(
        "{name}: no switching frequency from {from_khz:.1} to {to_khz:.1} kHz in {what}: is the inverter \
         running, are the probes on, are the right columns chosen?"
    )]
    NoCarrier {
        /// The capture.
        name: String,
        /// Lower end of the search in kilohertz.
        from_khz: f64,
        /// Upper end in kilohertz.
        to_khz: f64,
        /// Where it was looked for.
        what: &'static str,
    },
    /// The frequency given is not there, another is.
    #[error(
        "{name}: no switching frequency near the {specified_khz:.2} kHz given; {found_khz:.2} kHz is there: leave \
         the frequency out or correct it"
    )]
    NotAtHint {
        /// The capture.
        name: String,
        /// The frequency given, in kilohertz.
        specified_khz: f64,
        /// The one found, in kilohertz.
        found_khz: f64,
    },
}
