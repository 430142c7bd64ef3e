//! Replay: recorded pairs through a device's own sampling path, and its estimates back.

use ihd_firmware::replay::{BLOCK_BYTES, BLOCKS_PER_MESSAGE, NO_CROSSING};
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::{TRACK_BYTES, TrackEntry};
use ihd_shared::wire::messages::{Raw, ReplayBlocks, ReplayEnd, ReplayMode, ReplayStart};

use super::incoming::Answer;
use super::{Client, LinkError};

/// A device in replay mode: its power outputs are locked off until [`Replay::end`].
pub struct Replay<'a> {
    client: &'a mut Client,
}

impl Client {
    /// Puts the device into replay mode at a switching frequency in hertz; its estimator starts
    /// from the given load.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while a fault is active or for a frequency outside the ratings, else
    /// as every command.
    pub fn start_replay(
        &mut self,
        f_sw_hz: u32,
        r: MicroOhm,
        l: PicoHenry,
    ) -> Result<Replay<'_>, LinkError> {
        self.ask(&ReplayStart { f_sw_hz, r, l }, "ReplayStart", mode)?;
        Ok(Replay { client: self })
    }
}

impl Replay<'_> {
    /// Replays whole blocks with the bus voltage in decivolt and the index of the first pair after
    /// a mains zero crossing, if one falls into them. One estimate a block; `None` where the
    /// device made none. Pairs beyond the last whole block are left out.
    ///
    /// # Errors
    /// [`LinkError::NotReplaying`] when the device has left replay mode (a reset), else as every
    /// command.
    pub fn blocks(
        &mut self,
        pairs: &[Pair],
        zero_crossing: Option<usize>,
        bus_dv: u16,
    ) -> Result<Vec<Option<TrackEntry>>, LinkError> {
        let mut estimates = Vec::new();
        let whole = &pairs[..pairs.len() - pairs.len() % ADC_LOCK_P];
        let per_message = BLOCKS_PER_MESSAGE * ADC_LOCK_P;
        for (k, part) in whole.chunks(per_message).enumerate() {
            let crossing = zero_crossing
                .and_then(|at| at.checked_sub(k * per_message))
                .filter(|&at| at < part.len());
            estimates.extend(self.message(part, crossing, bus_dv)?);
        }
        Ok(estimates)
    }

    fn message(
        &mut self,
        pairs: &[Pair],
        crossing: Option<usize>,
        bus_dv: u16,
    ) -> Result<Vec<Option<TrackEntry>>, LinkError> {
        let bytes: Vec<u8> = pairs.iter().flat_map(|p| p.to_le_bytes()).collect();
        debug_assert!(bytes.len() <= BLOCKS_PER_MESSAGE * BLOCK_BYTES);
        let blocks = ReplayBlocks {
            zero_crossing: crossing.map_or(NO_CROSSING, |at| at as u16),
            bus_dv,
            data: Raw(&bytes),
        };
        let answer = self
            .client
            .ask(&blocks, "ReplayBlocks", |answer| match answer {
                Answer::ReplayEstimates(_, bytes) => Some(Some(bytes)),
                Answer::ReplayMode(_) => Some(None),
                _ => None,
            })?;
        let Some(bytes) = answer else {
            return Err(LinkError::NotReplaying {
                device: self.client.describe(),
            });
        };
        Ok(bytes.chunks_exact(TRACK_BYTES).map(entry).collect())
    }

    /// The device behind the replay, for its other commands and events.
    pub fn client(&mut self) -> &mut Client {
        self.client
    }

    /// Leaves replay mode; returns how many blocks the device has taken.
    ///
    /// # Errors
    /// As every command.
    pub fn end(self) -> Result<u32, LinkError> {
        let mode = self.client.ask(&ReplayEnd {}, "ReplayEnd", mode)?;
        Ok(mode.blocks)
    }
}

fn mode(answer: Answer) -> Option<ReplayMode> {
    match answer {
        Answer::ReplayMode(mode) => Some(mode),
        _ => None,
    }
}

fn entry(bytes: &[u8]) -> Option<TrackEntry> {
    let bytes: [u8; TRACK_BYTES] = bytes.try_into().ok()?;
    let entry = TrackEntry::from_le_bytes(bytes);
    // No load has both at zero: it is the mark of a block without an estimate.
    (entry != TrackEntry::default()).then_some(entry)
}
