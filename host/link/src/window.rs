//! Window as the host uses it, and its possible defects.

use ihd_shared::sampling::{ADC_LOCK_Q, Pair, Scales, f_adc_hz};
use ihd_shared::window::TrajectoryEntry;
use ihd_signal::{Segment, current_transformer};

/// Largest fraction of saturated pairs in a usable window: 0.1 %.
///
/// A clipped pair is wrong by an unknown amount, at worst about the amplitude itself. A fraction s of them therefore shifts the
/// fundamental by up to 2·s: 0.2 %, below the required accuracy of R and L of 0.5-1 %. Single spikes pass, a clipped crest (several
/// percent of the pairs) does not.
pub const MAX_SATURATED_FRACTION: f64 = 1e-3;

/// One mains half-cycle of samples and the device's own estimates through it.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Number of the window; windows that the device dropped are counted too.
    pub seq: u32,
    /// Number of the half-cycle since the device's boot.
    pub half_cycle: u32,
    /// Switching frequency throughout, in hertz.
    pub f_sw_hz: u32,
    /// Duration of the half-cycle, in nanoseconds.
    pub half_cycle_ns: u32,
    /// Time of the first pair after the mains zero crossing, in nanoseconds.
    pub first_pair_ns: i32,
    /// Sample pairs, equally spaced by [`Window::dt_s`].
    pub pairs: Vec<Pair>,
    /// Time of the first trajectory entry after the mains zero crossing, in nanoseconds.
    pub first_trajectory_ns: i32,
    /// The device's R and L, one entry per block of samples.
    pub trajectory: Vec<TrajectoryEntry>,
    /// Pairs at the end of the ADC's range.
    pub saturated: u16,
    /// Version of the lookup that was active.
    pub lookup_version: u32,
    /// Scales of the pairs' codes.
    pub scales: Scales,
}

impl Window {
    /// Mains frequency, in hertz.
    pub fn f_mains_hz(&self) -> f64 {
        0.5e9 / f64::from(self.half_cycle_ns)
    }

    /// Pairs in the bytes of the wire.
    pub fn pair_bytes(&self) -> Vec<u8> {
        self.pairs.iter().flat_map(|p| p.to_le_bytes()).collect()
    }

    /// Entries of the trajectory in the bytes of the wire.
    pub fn trajectory_bytes(&self) -> Vec<u8> {
        let entries = self.trajectory.iter();
        entries.flat_map(|entry| entry.to_le_bytes()).collect()
    }

    /// Converts the pairs to an estimator's input; time counts from the mains zero crossing. The voltage gets the droop that the
    /// current has from its transformer.
    pub fn segment(&self) -> Segment {
        let mut v_v = self.v_volt();
        current_transformer::droop(&mut v_v, self.dt_s(), current_transformer::BOARD_TAU_S);
        Segment {
            f_sw_hz: f64::from(self.f_sw_hz),
            mains_hz: self.f_mains_hz(),
            zero_crossing_s: 0.0,
            t0_s: f64::from(self.first_pair_ns) * 1e-9,
            dt_s: self.dt_s(),
            v_v: v_v.into(),
            i_a: self.i_ampere().into(),
        }
    }

    /// Time between two pairs, in seconds.
    pub fn dt_s(&self) -> f64 {
        f_adc_hz(self.f_sw_hz).recip()
    }

    /// Coil voltage, in volt, as it was sampled.
    pub fn v_volt(&self) -> Vec<f64> {
        let volt_per_code = self.scales.volt_per_code();
        let volt = |p: &Pair| f64::from(p.v) * volt_per_code;
        self.pairs.iter().map(volt).collect()
    }

    /// Coil current, in ampere, as it was sampled.
    pub fn i_ampere(&self) -> Vec<f64> {
        let ampere_per_code = self.scales.ampere_per_code();
        let ampere = |p: &Pair| f64::from(p.i) * ampere_per_code;
        self.pairs.iter().map(ampere).collect()
    }

    /// Time of pair `k` after the mains zero crossing, in seconds.
    pub fn pair_time_s(&self, k: usize) -> f64 {
        f64::from(self.first_pair_ns) * 1e-9 + k as f64 * self.dt_s()
    }

    /// Time of trajectory entry `k` after the mains zero crossing, in seconds.
    pub fn trajectory_time_s(&self, k: usize) -> f64 {
        f64::from(self.first_trajectory_ns) * 1e-9
            + k as f64 * f64::from(ADC_LOCK_Q) / f64::from(self.f_sw_hz)
    }
}

/// Reason for rejecting a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WindowDefect {
    /// Chunks or an end came without a start.
    #[error("its start is missing")]
    NoStart,
    /// Two different starts with the same number.
    #[error("its start came twice, and not the same")]
    RepeatedStart,
    /// Another window began, or the stream ended, before the window's end.
    #[error("its end is missing")]
    NoEnd,
    /// The start declares more than a window may hold.
    #[error(
        "it declares {pairs} pairs and {trajectory} trajectory entries, more than fit a window"
    )]
    TooLarge {
        /// Pairs declared.
        pairs: u16,
        /// Trajectory entries declared.
        trajectory: u16,
    },
    /// The start declares no pairs, or a frequency, duration or scale of zero.
    #[error("it declares no pairs, no frequency, no duration or no scale")]
    Empty,
    /// Pairs or trajectory entries are missing before `offset`.
    #[error("a chunk is missing before {of} {offset}")]
    MissingChunk {
        /// Part of the window.
        of: WindowPart,
        /// End of the gap.
        offset: u16,
    },
    /// Two chunks differ in entries that both contain.
    #[error("two chunks contradict each other at {of} {offset}")]
    RepeatedChunk {
        /// Part of the window.
        of: WindowPart,
        /// Its offset.
        offset: u16,
    },
    /// A chunk reaches beyond what the start declared.
    #[error("a chunk at {of} {offset} reaches beyond the declared size")]
    ChunkBeyondEnd {
        /// Part of the window.
        of: WindowPart,
        /// Offset of the chunk.
        offset: u16,
    },
    /// A chunk is empty or not a whole number of entries.
    #[error("a chunk of {bytes} bytes is not a whole number of {of} entries")]
    RaggedChunk {
        /// Part of the window.
        of: WindowPart,
        /// Its length.
        bytes: usize,
    },
    /// The CRC-32 over the whole window does not match.
    #[error("its CRC-32 does not match")]
    Crc,
    /// Too many pairs at the end of the ADC's range.
    #[error("{pairs} of its {of} pairs are at the end of the ADC's range")]
    Saturated {
        /// Saturated pairs.
        pairs: u16,
        /// All pairs.
        of: u16,
    },
}

impl WindowDefect {
    /// The kind of defect in two words, the key of [`super::ClientCounters::windows_rejected`].
    pub fn label(self) -> &'static str {
        match self {
            Self::NoStart => "no start",
            Self::RepeatedStart => "repeated start",
            Self::NoEnd => "no end",
            Self::TooLarge { .. } => "too large",
            Self::Empty => "empty",
            Self::MissingChunk { .. } => "missing chunk",
            Self::RepeatedChunk { .. } => "repeated chunk",
            Self::ChunkBeyondEnd { .. } => "chunk beyond end",
            Self::RaggedChunk { .. } => "ragged chunk",
            Self::Crc => "crc",
            Self::Saturated { .. } => "saturated",
        }
    }
}

/// The two parts of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowPart {
    /// Sample pairs.
    Pair,
    /// Trajectory entries.
    Trajectory,
}

impl std::fmt::Display for WindowPart {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pair => "pair",
            Self::Trajectory => "trajectory",
        })
    }
}
