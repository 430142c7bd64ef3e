//! What travels: windows to workers, results to edges. A byte for the version, then postcard, both in zstd with its checksum; what people
//! and other programs are to read (states, events, cards) is JSON.

use ihd_daemon::config::is_name;
use ihd_daemon::learning::{NotTaken, Studied};
use ihd_link::Window;
use ihd_shared::sampling::{Pair, Scales};
use ihd_shared::window::{PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use zstd::bulk::Compressor;
use zstd::zstd_safe::CParameter;

/// First byte of an unpacked message. What a reader of this version cannot read has another one.
const FORMAT: u8 = 1;

/// zstd's level: as in the store, more costs time and saves little.
const LEVEL: i32 = 1;

/// Largest message unpacked, in bytes: twice the longest window there is.
pub const LARGEST: usize = 4 << 20;

/// A window on its way to a worker.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowMessage {
    /// The hob's name, unique in the site.
    pub hob: String,
    /// The hob's boot.
    pub boot: u32,
    /// When the edge stored it, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The skew in seconds that is to be taken out of its current.
    pub skew_s: Option<f64>,
    /// The window.
    pub window: Window,
}

/// What was found in a window, on its way to its edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResultMessage {
    /// The hob's name.
    pub hob: String,
    /// The hob's boot.
    pub boot: u32,
    /// Who found it: the worker's name, or the edge's.
    pub by: String,
    /// When the edge stored the window, in milliseconds since 1970, UTC.
    pub window_at_ms: i64,
    /// When it was found, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// What was found.
    pub studied: Studied,
}

/// Why a message cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Not zstd, cut, or with a flipped bit.
    #[error("it cannot be unpacked: {0}")]
    Packed(std::io::Error),
    /// Empty.
    #[error("it is empty")]
    Empty,
    /// Another version's.
    #[error(
        "it has format {0}, this ihd reads format {FORMAT}: bring edges and workers to one version"
    )]
    Format(u8),
    /// Not what it should be.
    #[error("it is damaged: {0}")]
    Damaged(#[from] postcard::Error),
    /// A name that cannot be a hob's.
    #[error("it names a hob {0:?}, which cannot be")]
    Hob(String),
    /// Numbers that cannot be.
    #[error(transparent)]
    NotTaken(#[from] NotTaken),
}

/// A window as it is packed: the samples as the device sent them.
#[derive(Serialize, Deserialize)]
struct Packed {
    hob: String,
    boot: u32,
    at_ms: i64,
    skew_s: Option<f64>,
    seq: u32,
    half_cycle: u32,
    f_sw_hz: u32,
    half_cycle_ns: u32,
    first_pair_ns: i32,
    first_trajectory_ns: i32,
    saturated: u16,
    lookup_version: u32,
    v_full_scale_mv: u32,
    i_full_scale_ma: u32,
    pairs: Vec<[u8; PAIR_BYTES]>,
    trajectory: Vec<[u8; TRAJECTORY_ENTRY_BYTES]>,
}

impl WindowMessage {
    /// As it is published.
    ///
    /// # Errors
    /// What zstd or postcard report: a lack of memory.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MessageError> {
        let window = &self.window;
        pack(&Packed {
            hob: self.hob.clone(),
            boot: self.boot,
            at_ms: self.at_ms,
            skew_s: self.skew_s,
            seq: window.seq,
            half_cycle: window.half_cycle,
            f_sw_hz: window.f_sw_hz,
            half_cycle_ns: window.half_cycle_ns,
            first_pair_ns: window.first_pair_ns,
            first_trajectory_ns: window.first_trajectory_ns,
            saturated: window.saturated,
            lookup_version: window.lookup_version,
            v_full_scale_mv: window.scales.v_full_scale_mv,
            i_full_scale_ma: window.scales.i_full_scale_ma,
            pairs: window.pairs.iter().map(|p| p.to_le_bytes()).collect(),
            trajectory: window.trajectory.iter().map(|t| t.to_le_bytes()).collect(),
        })
    }

    /// Of what was published.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let packed: Packed = unpack(bytes)?;
        let entries = packed.trajectory.iter();
        Ok(Self {
            hob: checked(packed.hob)?,
            boot: packed.boot,
            at_ms: packed.at_ms,
            skew_s: packed.skew_s.filter(|skew_s| skew_s.is_finite()),
            window: Window {
                seq: packed.seq,
                half_cycle: packed.half_cycle,
                f_sw_hz: packed.f_sw_hz,
                half_cycle_ns: packed.half_cycle_ns,
                first_pair_ns: packed.first_pair_ns,
                pairs: packed
                    .pairs
                    .iter()
                    .map(|b| Pair::from_le_bytes(*b))
                    .collect(),
                first_trajectory_ns: packed.first_trajectory_ns,
                trajectory: entries
                    .map(|b| TrajectoryEntry::from_le_bytes(*b))
                    .collect(),
                saturated: packed.saturated,
                lookup_version: packed.lookup_version,
                scales: Scales {
                    v_full_scale_mv: packed.v_full_scale_mv,
                    i_full_scale_ma: packed.i_full_scale_ma,
                },
            },
        })
    }
}

impl ResultMessage {
    /// As it is published.
    ///
    /// # Errors
    /// What zstd or postcard report: a lack of memory.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MessageError> {
        pack(self)
    }

    /// Of what was published.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let mut message: Self = unpack(bytes)?;
        message.hob = checked(message.hob)?;
        message.studied.check()?;
        Ok(message)
    }
}

fn checked(hob: String) -> Result<String, MessageError> {
    match is_name(&hob) {
        true => Ok(hob),
        false => Err(MessageError::Hob(hob.chars().take(64).collect())),
    }
}

fn pack<T: Serialize>(message: &T) -> Result<Vec<u8>, MessageError> {
    let bytes = postcard::to_extend(message, vec![FORMAT])?;
    let packed = || {
        let mut compressor = Compressor::new(LEVEL)?;
        compressor.set_parameter(CParameter::ChecksumFlag(true))?;
        compressor.compress(&bytes)
    };
    packed().map_err(MessageError::Packed)
}

fn unpack<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, MessageError> {
    let bytes = zstd::bulk::decompress(bytes, LARGEST).map_err(MessageError::Packed)?;
    match bytes.split_first() {
        None => Err(MessageError::Empty),
        Some((&FORMAT, message)) => Ok(postcard::from_bytes(message)?),
        Some((&format, _)) => Err(MessageError::Format(format)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window() -> WindowMessage {
        let pair = |k: u8| Pair::from_le_bytes([k, 0, 255 - k, 0]);
        WindowMessage {
            hob: "bench-1".into(),
            boot: 0xDEAD_BEEF,
            at_ms: 1_795_000_000_000,
            skew_s: Some(-60e-9),
            window: Window {
                seq: 4_711,
                half_cycle: 23_555,
                f_sw_hz: 45_000,
                half_cycle_ns: 10_000_000,
                first_pair_ns: -500,
                pairs: (0..=255).cycle().take(9_000).map(pair).collect(),
                first_trajectory_ns: 12,
                trajectory: Vec::new(),
                saturated: 3,
                lookup_version: 9,
                scales: Scales::OF_THIS_BUILD,
            },
        }
    }

    #[test]
    fn a_window_travels_bit_for_bit() {
        let message = window();
        let bytes = message.to_bytes().unwrap();
        assert_eq!(WindowMessage::from_bytes(&bytes).unwrap(), message);
    }

    #[test]
    fn whatever_is_cut_or_flipped_is_an_error_and_no_panic() {
        let bytes = window().to_bytes().unwrap();
        for end in (0..bytes.len()).step_by(37) {
            assert!(WindowMessage::from_bytes(&bytes[..end]).is_err(), "{end}");
        }
        for at in (0..bytes.len()).step_by(11) {
            let mut wrong = bytes.clone();
            wrong[at] ^= 0x10;
            // Some bits of a zstd frame mean nothing.
            if let Ok(read) = WindowMessage::from_bytes(&wrong) {
                assert_eq!(read, window(), "byte {at}");
            }
        }
    }

    #[test]
    fn another_version_and_a_bomb_are_refused_in_words() {
        let other = zstd::bulk::compress(&[2, 0, 0], LEVEL).unwrap();
        let why = WindowMessage::from_bytes(&other).unwrap_err().to_string();
        assert!(why.contains("format 2"), "{why}");
        let bomb = zstd::bulk::compress(&vec![FORMAT; 64 << 20], 19).unwrap();
        assert!(WindowMessage::from_bytes(&bomb).is_err());
        let hob = WindowMessage {
            hob: "a.>".into(),
            ..window()
        };
        let why = WindowMessage::from_bytes(&hob.to_bytes().unwrap()).unwrap_err();
        assert!(matches!(why, MessageError::Hob(_)), "{why}");
    }
}
