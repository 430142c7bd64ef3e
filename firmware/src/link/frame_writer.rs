//! Frames of the outgoing side, each with the next number of their sequence.

use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::messages::Message;
use ihd_shared::wire::number::Number;

/// Encoder of messages; counts frames, so that the host sees a loss as a gap.
#[derive(Clone, Debug, Default)]
pub struct FrameWriter {
    seq: u16,
}

impl FrameWriter {
    /// Writes a message that answers no request; returns the frame's length.
    pub fn write<M: Message>(&mut self, message: &M, out: &mut [u8; MAX_ENCODED]) -> usize {
        self.write_numbered(message, Number::NONE, out)
    }

    /// Writes the response to the request of this number; returns the frame's length.
    pub fn write_numbered<M: Message>(
        &mut self,
        message: &M,
        number: Number,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        let seq = self.seq;
        self.seq = seq.wrapping_add(1);
        // Every message of the table fits; a test in `tests/` encodes the longest of each.
        encode_numbered(message, number, seq, out).unwrap_or(0)
    }
}
