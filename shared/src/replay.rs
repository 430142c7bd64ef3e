//! Layout of replayed blocks: what [`crate::wire::messages::ReplayBlocks`] carries.
//!
//! A message holds up to [`BLOCKS_PER_MESSAGE`] whole blocks, one after the other, each
//! [`ADC_LOCK_P`] pairs of [`crate::sampling::Pair::to_le_bytes`].

use crate::sampling::ADC_LOCK_P;
use crate::window::PAIR_BYTES;
use crate::wire::frame::MAX_PAYLOAD;

/// Blocks that fit one message.
pub const BLOCKS_PER_MESSAGE: usize = 4;

/// Bytes of one block on the wire.
pub const BLOCK_BYTES: usize = ADC_LOCK_P * PAIR_BYTES;

/// [`crate::wire::messages::ReplayBlocks::zero_crossing`] when no zero crossing falls into the
/// blocks.
pub const NO_CROSSING: u16 = u16::MAX;

// Beside the blocks: the number of the request, two varints of a u16, and the length.
const _: () = assert!(BLOCKS_PER_MESSAGE * BLOCK_BYTES + 2 + 3 + 3 + 2 <= MAX_PAYLOAD);
