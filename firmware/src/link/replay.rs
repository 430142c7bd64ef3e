//! Replay mode: the sampling path fed with recorded blocks from the link instead of the ADC.
//!
//! It is how a host proves that a board estimates what the host's own build of this crate does, bit
//! for bit. [`crate::sampling::path::SamplingPath`] ignores the ADC and keeps the bridge off for as long as it lasts; the
//! hello reports it ([`ihd_shared::wire::hello::CAP_REPLAYING`]).

use ihd_shared::fault::Fault;
use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::lookup::prior::start_load;
use ihd_shared::replay::{BLOCK_BYTES, BLOCKS_PER_MESSAGE};
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::window::{PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use ihd_shared::wire::messages::{
    Outcome, Raw, ReplayBlocks, ReplayEstimates, ReplayMode, ReplayStart,
};

use crate::sampling::path::{AdcBlock, SamplingLock};
use crate::sense::bus::BusReading;

/// Estimates from the blocks of one message.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReplayedEstimates {
    first: u32,
    entries: [TrajectoryEntry; BLOCKS_PER_MESSAGE],
    count: usize,
}

impl ReplayedEstimates {
    /// Most bytes of a message.
    pub const BYTES: usize = BLOCKS_PER_MESSAGE * TRAJECTORY_ENTRY_BYTES;

    /// The message, its bytes in `raw`.
    pub fn message<'a>(&self, raw: &'a mut [u8; Self::BYTES]) -> ReplayEstimates<'a> {
        let count = self.count.min(BLOCKS_PER_MESSAGE);
        for (entry, slot) in self
            .entries
            .iter()
            .zip(raw.chunks_exact_mut(TRAJECTORY_ENTRY_BYTES))
        {
            slot.copy_from_slice(&entry.to_le_bytes());
        }
        ReplayEstimates {
            first: self.first,
            data: Raw(&raw[..count * TRAJECTORY_ENTRY_BYTES]),
        }
    }
}

/// Replay mode as the link sees it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Replay {
    blocks: u32,
    /// The last answer, for a host that did not get it.
    last: ReplayedEstimates,
}

impl Replay {
    /// Enters replay mode, or begins another replay within it. The bridge must be open already: opened at the mains' crest, the
    /// line's current would charge the DC link.
    ///
    /// # Errors
    /// Outcome and detail, and nothing has changed: the frequency is outside the ratings, a fault is active, or the bridge is on or about
    /// to be.
    pub fn start(
        &mut self,
        lock: &mut impl SamplingLock,
        m: &ReplayStart,
        power_is_requested: bool,
    ) -> Result<ReplayMode, (Outcome, u32)> {
        if !(F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&m.f_sw_hz) {
            return Err((Outcome::Malformed, 0));
        }
        lock.with(|path| {
            let fault = path.fault();
            if fault != Fault::NONE {
                return Err((Outcome::FaultActive, u32::from(fault.number())));
            }
            if power_is_requested || !(path.is_replaying() || path.is_bridge_open()) {
                return Err((Outcome::NotIdle, 0));
            }
            path.set_replay(true, m.f_sw_hz, m.r, m.l);
            Ok(())
        })?;
        *self = Self::default();
        Ok(ReplayMode {
            active: true,
            blocks: 0,
        })
    }

    /// Leaves replay mode; the estimator expects the built-in prior's load again.
    pub fn end(&mut self, lock: &mut impl SamplingLock) -> ReplayMode {
        let (r, l) = start_load();
        lock.with(|path| {
            if path.is_replaying() {
                path.set_replay(false, F_SW_MAX_HZ, r, l);
            }
        });
        ReplayMode {
            active: false,
            blocks: self.blocks,
        }
    }

    /// Replays the blocks of one message. A message without blocks requests the last answer again, and a request that comes
    /// twice is carried out once ([`crate::link::conversation`]): so nothing that a link does makes the estimator see a block twice
    /// or not at all.
    ///
    /// # Errors
    /// The outcome: they are not whole blocks or too many, or the device is not in replay mode.
    pub fn blocks(
        &mut self,
        lock: &mut impl SamplingLock,
        m: &ReplayBlocks<'_>,
    ) -> Result<ReplayedEstimates, Outcome> {
        let bytes = m.data.0;
        let count = bytes.len() / BLOCK_BYTES;
        if !bytes.len().is_multiple_of(BLOCK_BYTES) || count > BLOCKS_PER_MESSAGE {
            return Err(Outcome::Malformed);
        }
        if !lock.with(|path| path.is_replaying()) {
            return Err(Outcome::NotReplaying);
        }
        if count == 0 {
            return Ok(self.last);
        }
        let mut entries = [TrajectoryEntry::default(); BLOCKS_PER_MESSAGE];
        let blocks = bytes.chunks_exact(BLOCK_BYTES);
        for (k, (entry, block)) in entries.iter_mut().zip(blocks).enumerate() {
            let crossing = usize::from(m.zero_crossing).checked_sub(k * ADC_LOCK_P);
            let estimate = replay_one(lock, block, crossing, m.bus_dv);
            *entry = estimate.unwrap_or_default();
        }
        let first = self.blocks;
        self.blocks = first.wrapping_add(count as u32);
        self.last = ReplayedEstimates {
            first,
            entries,
            count,
        };
        Ok(self.last)
    }
}

/// Replays one block, in one short claim on the sampling path. `crossing` counts from the block's first pair.
fn replay_one(
    lock: &mut impl SamplingLock,
    bytes: &[u8],
    crossing: Option<usize>,
    bus_dv: u16,
) -> Option<TrajectoryEntry> {
    let mut pairs = [Pair::default(); ADC_LOCK_P];
    for (pair, b) in pairs.iter_mut().zip(bytes.chunks_exact(PAIR_BYTES)) {
        *pair = Pair::from_le_bytes([b[0], b[1], b[2], b[3]]);
    }
    let zero_crossing = crossing.filter(|&at| at < ADC_LOCK_P).map(|at| at as u8);
    lock.with(|path| {
        path.replay_block(&AdcBlock {
            pairs: &pairs,
            zero_crossing,
            bus: BusReading::steady(bus_dv),
            dc_link_ma: None,
            lost: 0,
        })
    })
}
