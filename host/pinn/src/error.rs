//! Errors of an identification, worded so that the reader knows what to change.

/// Reason why a half-cycle could not be identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PinnError {
    /// Voltage and current differ in length.
    #[error(
        "waveform: {v} voltage samples but {i} current samples; pass the two channels of one window"
    )]
    LengthMismatch {
        /// Number of voltage samples.
        v: usize,
        /// Number of current samples.
        i: usize,
    },
    /// Too few samples for the unknowns of the VI branch.
    #[error(
        "waveform: {pairs} sample pairs, but the VI branch needs at least {needed} \
         ({why}); record a longer part of the half-cycle"
    )]
    TooShort {
        /// Sample pairs given.
        pairs: usize,
        /// Sample pairs needed.
        needed: usize,
        /// Rule that requires so many.
        why: &'static str,
    },
    /// A sample is NaN or infinite.
    #[error(
        "waveform: {channel} sample {index} is {value}; drop the window or repair the recording"
    )]
    NonFiniteSample {
        /// `voltage` or `current`.
        channel: &'static str,
        /// Index of the first bad sample.
        index: usize,
        /// Value of the sample.
        value: f64,
    },
    /// A quantity that must be positive and finite is not.
    #[error("waveform: {what} is {value}, but it must be a positive number")]
    NotPositive {
        /// Name of the field.
        what: &'static str,
        /// Value of the field.
        value: f64,
    },
    /// A channel holds zeros only.
    #[error(
        "waveform: the {channel} is zero throughout; is the inverter running and the probe on?"
    )]
    NoSignal {
        /// `voltage` or `current`.
        channel: &'static str,
    },
    /// The sampling frequency is too low to separate the harmonics.
    #[error(
        "waveform: sampled at {f_adc_hz:.0} Hz, which cannot separate harmonic {harmonic} of \
         {f_sw_hz:.0} Hz; sample above {needed_hz:.0} Hz or drop that harmonic"
    )]
    SamplingTooSlow {
        /// Sampling frequency, Hz.
        f_adc_hz: f64,
        /// Switching frequency, Hz.
        f_sw_hz: f64,
        /// Highest harmonic of the VI branch.
        harmonic: u32,
        /// Sampling frequency above which it is separable, Hz.
        needed_hz: f64,
    },
    /// The window reaches over a mains zero crossing, where the envelope has a kink.
    #[error(
        "waveform: the window covers {from_s:.6} s to {to_s:.6} s, but a half-cycle ends at \
         {half_cycle_s:.6} s; cut the window at the mains zero crossings"
    )]
    SpansZeroCrossing {
        /// Time of the first pair after the zero crossing, s.
        from_s: f64,
        /// Time of the last pair, s.
        to_s: f64,
        /// Length of a mains half-cycle, s.
        half_cycle_s: f64,
    },
    /// A setting is out of its range.
    #[error("config: {field} {problem}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// Description of the fault, with the allowed range.
        problem: String,
    },
    /// The parameters of the warm start do not fit the configured network.
    #[error(
        "config: warm start has layers {given}, but hidden_layers asks for {configured}; \
         set hidden_layers to match or drop the warm start"
    )]
    WarmStart {
        /// Layer widths of the warm start.
        given: String,
        /// Layer widths of the configuration.
        configured: String,
    },
    /// The normal equations of the VI branch are singular.
    #[error(
        "VI branch: the harmonics cannot be told apart on this window (row {row} of the normal \
         equations); use fewer spline_intervals or fewer harmonics"
    )]
    Singular {
        /// Row at which the Cholesky factorisation broke down.
        row: usize,
    },
    /// burn has no such device, or a tensor could not be read back.
    #[error("burn backend {backend}: {detail}; take fused, which needs none")]
    Backend {
        /// The backend in use.
        backend: String,
        /// Message of burn.
        detail: String,
    },
    /// Unknown name.
    #[error("unknown {what} {name:?}; known: {known}")]
    UnknownName {
        /// Kind of the name.
        what: &'static str,
        /// The name given.
        name: String,
        /// Valid names.
        known: String,
    },
    /// A configuration file that cannot be read.
    #[error("configuration: {detail}")]
    File {
        /// Message of the parser.
        detail: String,
    },
    /// A checkpoint that cannot be written, read or used.
    #[error("checkpoint {path}: {detail}")]
    Checkpoint {
        /// Path of the file.
        path: String,
        /// Description of the fault, with advice.
        detail: String,
    },
}

impl From<ihd_spline::SingularMatrix> for PinnError {
    fn from(singular: ihd_spline::SingularMatrix) -> Self {
        Self::Singular { row: singular.row }
    }
}
