//! Frames of a test of the link: known bytes, as fast as the link takes them.

use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::link_test::fill;
use ihd_shared::wire::messages::{LinkData, Raw};

use crate::link::frame_writer::FrameWriter;

/// Frames that are still to be sent.
#[derive(Clone, Copy, Default)]
pub struct LinkTestSender {
    seq: u32,
    frames: u16,
    bytes: u16,
}

impl LinkTestSender {
    /// Begins a test of so many frames with so many bytes each.
    pub fn new(frames: u16, bytes: u16) -> Self {
        Self {
            seq: 0,
            frames,
            bytes,
        }
    }

    /// Writes the next frame; returns its length, 0 if none is left.
    #[inline(never)]
    pub fn write(&mut self, frames: &mut FrameWriter, out: &mut [u8; MAX_ENCODED]) -> usize {
        if self.frames == 0 {
            return 0;
        }
        self.frames -= 1;
        let seq = self.seq;
        self.seq = seq.wrapping_add(1);
        let mut raw = [0; CHUNK_BYTES];
        let length = usize::from(self.bytes).min(CHUNK_BYTES);
        let data = &mut raw[..length];
        fill(seq, data);
        let data = Raw(data);
        frames.write(&LinkData { seq, data }, out)
    }
}
