//! Replay: recorded pairs go through a device's own sampling path, and its estimates come back.
//!
//! Every block is replayed exactly once and every estimate comes back, whatever the link loses, repeats or cuts; otherwise an error
//! reports it. One message is under way at a time. After a silence the host requests the number of the device's last message.

use std::time::Duration;

use ihd_shared::replay::{BLOCK_BYTES, BLOCKS_PER_MESSAGE, NO_CROSSING};
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::{TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use ihd_shared::wire::messages::{Outcome, Raw, ReplayBlocks, ReplayEnd, ReplayStart};

use super::{Client, LinkError};

/// Pairs in a full message.
pub const PAIRS_PER_MESSAGE: usize = BLOCKS_PER_MESSAGE * ADC_LOCK_P;

/// Attempts to send a message, or to read the last answer, before the link is given up.
const MAX_ATTEMPTS: u32 = 8;

/// Longest wait for a bridge that was switched off and opens at the end of the half-cycle.
const OPENS_WITHIN: Duration = Duration::from_secs(1);

/// Request for the last estimates again.
const LAST: ReplayBlocks<'static> = ReplayBlocks {
    zero_crossing: NO_CROSSING,
    bus_dv: 0,
    data: Raw(&[]),
};

/// A device in replay mode: its power outputs are locked off until [`ReplayMode::end`].
pub struct ReplayMode<'a> {
    client: &'a mut Client,
    /// Blocks whose estimates have come back.
    taken: u32,
    /// Set if the device may have replayed a message whose answer was lost.
    unsure: bool,
    /// Messages that were sent or requested again.
    repeats: u32,
}

/// Device's answer to a request for its last estimates.
enum Last {
    /// Estimates of the message under way.
    Same(Vec<u8>),
    /// The message under way has not arrived.
    Before,
    /// The device is not in replay mode.
    Left,
}

impl Client {
    /// Puts the device into replay mode at a switching frequency in hertz; its estimator starts
    /// from the given load. A bridge that was just switched off, by the hello of this client or by 0 W, is waited for.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while a fault is active, power is requested, or for a frequency outside the ratings, else
    /// any error of [`Client::request`].
    pub fn start_replay(
        &mut self,
        f_sw_hz: u32,
        r: MicroOhm,
        l: PicoHenry,
    ) -> Result<ReplayMode<'_>, LinkError> {
        let start = ReplayStart { f_sw_hz, r, l };
        let until = self.clock() + OPENS_WITHIN;
        loop {
            match retry_unanswered(|| self.request(&start)) {
                Ok(_) => return Ok(self.continue_replay(0)),
                Err(
                    why @ LinkError::Refused {
                        outcome: Outcome::NotIdle,
                        ..
                    },
                ) => {
                    let is_opening = retry_unanswered(|| self.status())?.asked_w == 0;
                    if !is_opening || self.clock() >= until {
                        return Err(why);
                    }
                    self.receive(OPENS_WITHIN / 100)?;
                }
                Err(why) => return Err(why),
            }
        }
    }

    /// Continues a replay of which `taken` blocks were sent and have come back.
    pub fn continue_replay(&mut self, taken: u32) -> ReplayMode<'_> {
        ReplayMode {
            client: self,
            taken,
            unsure: false,
            repeats: 0,
        }
    }

    /// Continues a replay like [`Client::continue_replay`], after the link has ended: the device may have replayed the next message
    /// already.
    pub fn resume_replay(&mut self, taken: u32) -> ReplayMode<'_> {
        ReplayMode {
            unsure: true,
            ..self.continue_replay(taken)
        }
    }
}

/// Repeats a request whose answer did not come; for requests that may be carried out twice.
///
/// # Errors
/// [`LinkError::NoAnswer`] after several tries, else the error of the request.
pub fn retry_unanswered<T>(mut ask: impl FnMut() -> Result<T, LinkError>) -> Result<T, LinkError> {
    let mut tries = 1;
    loop {
        match ask() {
            Err(LinkError::NoAnswer { .. }) if tries < MAX_ATTEMPTS => tries += 1,
            other => return other,
        }
    }
}

impl ReplayMode<'_> {
    /// Replays whole blocks, with the bus voltage in decivolt and the index of the first pair after a mains zero crossing (`None`
    /// if there is none). Returns one estimate per block; `None` if the device made none. Pairs after the last whole block are
    /// skipped.
    ///
    /// # Errors
    /// Any error of [`ReplayMode::message`].
    pub fn blocks(
        &mut self,
        pairs: &[Pair],
        zero_crossing: Option<usize>,
        bus_dv: u16,
    ) -> Result<Vec<Option<TrajectoryEntry>>, LinkError> {
        let mut estimates = Vec::new();
        let whole = &pairs[..pairs.len() - pairs.len() % ADC_LOCK_P];
        for (k, part) in whole.chunks(PAIRS_PER_MESSAGE).enumerate() {
            let crossing = zero_crossing
                .and_then(|at| at.checked_sub(k * PAIRS_PER_MESSAGE))
                .filter(|&at| at < part.len());
            estimates.extend(self.message(part, crossing, bus_dv)?);
        }
        Ok(estimates)
    }

    /// Replays the blocks of one message, at most [`PAIRS_PER_MESSAGE`] pairs; see [`ReplayMode::blocks`]. After [`LinkError::Closed`],
    /// [`Client::resume_replay`] continues with the same blocks.
    ///
    /// # Errors
    /// [`LinkError::NotReplaying`] if the device has left replay mode (a reset), [`LinkError::NoAnswer`] after several tries, else
    /// any error of [`Client::request`].
    pub fn message(
        &mut self,
        pairs: &[Pair],
        crossing: Option<usize>,
        bus_dv: u16,
    ) -> Result<Vec<Option<TrajectoryEntry>>, LinkError> {
        let bytes: Vec<u8> = pairs.iter().flat_map(|p| p.to_le_bytes()).collect();
        debug_assert!(bytes.len() <= BLOCKS_PER_MESSAGE * BLOCK_BYTES);
        let blocks = ReplayBlocks {
            zero_crossing: crossing.map_or(NO_CROSSING, |at| at as u16),
            bus_dv,
            data: Raw(&bytes),
        };
        let expected = pairs.len() / ADC_LOCK_P * TRAJECTORY_ENTRY_BYTES;
        let mut tries = 0;
        let answer = loop {
            tries += 1;
            let asked = if self.unsure {
                self.ask(&LAST, expected)
            } else {
                self.ask(&blocks, expected)
            };
            match asked {
                Ok(Last::Same(bytes)) => break bytes,
                Ok(Last::Before) => self.unsure = false,
                Ok(Last::Left) => {
                    return Err(LinkError::NotReplaying {
                        device: self.client.describe(),
                    });
                }
                Err(LinkError::NoAnswer { .. }) if tries < 2 * MAX_ATTEMPTS => self.unsure = true,
                Err(other) => return Err(other),
            }
            self.repeats += 1;
        };
        self.unsure = false;
        self.taken = self
            .taken
            .wrapping_add((answer.len() / TRAJECTORY_ENTRY_BYTES) as u32);
        Ok(answer
            .chunks_exact(TRAJECTORY_ENTRY_BYTES)
            .map(entry)
            .collect())
    }

    /// Sends blocks, or requests the last estimates: those of the message under way, or of the one before it.
    fn ask(&mut self, blocks: &ReplayBlocks<'_>, expected: usize) -> Result<Last, LinkError> {
        let (taken, device) = (self.taken, self.client.describe());
        let last = match self.client.request(blocks) {
            Err(LinkError::Refused {
                outcome: Outcome::NotReplaying,
                ..
            }) => return Ok(Last::Left),
            last => last?,
        };
        let (first, bytes) = (last.first, last.data.0);
        let behind = first.wrapping_add((bytes.len() / TRAJECTORY_ENTRY_BYTES) as u32);
        match (first == taken && bytes.len() == expected, behind == taken) {
            (true, _) => Ok(Last::Same(bytes.to_vec())),
            (false, true) => Ok(Last::Before),
            (false, false) => Err(LinkError::OutOfStep {
                device,
                taken: behind,
                sent: taken,
            }),
        }
    }

    /// Number of blocks whose estimates have come back.
    pub fn taken(&self) -> u32 {
        self.taken
    }

    /// Number of messages sent or requested again.
    pub fn repeats(&self) -> u32 {
        self.repeats
    }

    /// The device behind the replay, for its other commands and events.
    pub fn client(&mut self) -> &mut Client {
        self.client
    }

    /// Leaves replay mode; returns the number of blocks that the device replayed.
    ///
    /// # Errors
    /// [`LinkError::OutOfStep`] if it differs from the number sent, else any error of [`Client::request`].
    pub fn end(self) -> Result<u32, LinkError> {
        let mode = retry_unanswered(|| self.client.request(&ReplayEnd {}))?;
        if mode.blocks != self.taken {
            return Err(LinkError::OutOfStep {
                device: self.client.describe(),
                taken: mode.blocks,
                sent: self.taken,
            });
        }
        Ok(mode.blocks)
    }
}

fn entry(bytes: &[u8]) -> Option<TrajectoryEntry> {
    let bytes: [u8; TRAJECTORY_ENTRY_BYTES] = bytes.try_into().ok()?;
    let entry = TrajectoryEntry::from_le_bytes(bytes);
    // No load has R = L = 0: this marks a block without an estimate.
    (entry != TrajectoryEntry::default()).then_some(entry)
}
