//! Window for a worker.

use ihd_link::Window;
use ihd_shared::sampling::{Pair, Scales};
use ihd_shared::window::{PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use serde::{Deserialize, Serialize};

use super::packing::{pack, unpack};
use super::{MessageError, VERSION, check_hob, check_version};

/// Window for a worker.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowMessage {
    /// The hob's name, unique in the site.
    pub hob: String,
    /// The hob's boot.
    pub boot: u32,
    /// Time at which the edge stored it, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Skew in seconds by which its current is to be corrected.
    pub skew_s: Option<f64>,
    /// Workers whose answers the edge does not accept; they leave it to others.
    pub not_for: Vec<String>,
    /// The window.
    pub window: Window,
}

#[derive(Serialize, Deserialize)]
struct Fields {
    version: u16,
    hob: String,
    boot: u32,
    at_ms: i64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    skew_s: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    not_for: Vec<String>,
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
    /// Codes of voltage and current as the device sends them.
    #[serde(with = "serde_bytes")]
    pairs: Vec<u8>,
    /// The device's own R and L as the device sends them.
    #[serde(with = "serde_bytes")]
    trajectory: Vec<u8>,
}

impl WindowMessage {
    /// Serialises the message.
    ///
    /// # Errors
    /// [`MessageError::Packed`] if zstd lacks memory.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MessageError> {
        let window = &self.window;
        pack(&Fields {
            version: VERSION,
            hob: self.hob.clone(),
            boot: self.boot,
            at_ms: self.at_ms,
            skew_s: self.skew_s,
            not_for: self.not_for.clone(),
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
            pairs: window.pair_bytes(),
            trajectory: window.trajectory_bytes(),
        })
    }

    /// Reads a message.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let fields: Fields = unpack(bytes)?;
        check_version(fields.version)?;
        let pairs = chunks::<PAIR_BYTES>("pairs", &fields.pairs)?;
        let entries = chunks::<TRAJECTORY_ENTRY_BYTES>("trajectory", &fields.trajectory)?;
        Ok(Self {
            hob: check_hob(fields.hob)?,
            boot: fields.boot,
            at_ms: fields.at_ms,
            skew_s: fields.skew_s.filter(|skew_s| skew_s.is_finite()),
            not_for: fields.not_for,
            window: Window {
                seq: fields.seq,
                half_cycle: fields.half_cycle,
                f_sw_hz: fields.f_sw_hz,
                half_cycle_ns: fields.half_cycle_ns,
                first_pair_ns: fields.first_pair_ns,
                pairs: pairs.iter().map(|b| Pair::from_le_bytes(*b)).collect(),
                first_trajectory_ns: fields.first_trajectory_ns,
                trajectory: entries
                    .iter()
                    .map(|b| TrajectoryEntry::from_le_bytes(*b))
                    .collect(),
                saturated: fields.saturated,
                lookup_version: fields.lookup_version,
                scales: Scales {
                    v_full_scale_mv: fields.v_full_scale_mv,
                    i_full_scale_ma: fields.i_full_scale_ma,
                },
            },
        })
    }
}

fn chunks<'a, const N: usize>(
    field: &'static str,
    bytes: &'a [u8],
) -> Result<&'a [[u8; N]], MessageError> {
    match bytes.as_chunks::<N>() {
        (chunks, []) => Ok(chunks),
        _ => {
            let why = format!("have {} bytes, no multiple of {N}", bytes.len());
            Err(MessageError::value(field, why))
        }
    }
}
