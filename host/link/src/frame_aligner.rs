//! Start of a recording at a whole frame.

/// Skips the bytes of a device up to the end of a frame whose beginning is not recorded.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameAligner {
    /// Set once the next byte begins a frame or continues one that was passed on.
    in_step: bool,
}

impl FrameAligner {
    /// Begins where the last byte was within a frame, or not.
    pub fn new(mid_frame: bool) -> Self {
        Self {
            in_step: !mid_frame,
        }
    }

    /// Returns the part of `bytes` that belongs to whole frames; empty before the first frame begins.
    pub fn whole_frames<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        if self.in_step {
            return bytes;
        }
        let Some(end) = bytes.iter().position(|&byte| byte == 0) else {
            return &[];
        };
        self.in_step = true;
        &bytes[end + 1..]
    }
}
