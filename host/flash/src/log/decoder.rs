//! Decoder from the bytes of a log to messages.

use super::frames::{LogFrame, LogFrames};
use super::message::LogMessage;
use super::table::LogTable;

/// Decoded item of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decoded {
    /// A message.
    Message(LogMessage),
    /// Frame that is no message of the image: damaged or too long.
    Malformed,
    /// Frame without a table to decode it.
    Unread,
}

/// Decoder of a log. It buffers one frame at most, of [`super::frames::MAX_FRAME`] bytes.
pub struct Decoder {
    table: Option<LogTable>,
    frames: LogFrames,
}

impl Decoder {
    /// Creates a decoder for the log of one image; without a table it only counts.
    pub fn new(table: Option<LogTable>) -> Self {
        Self {
            table,
            frames: LogFrames::default(),
        }
    }

    /// Table of the image.
    pub fn table(&self) -> Option<&LogTable> {
        self.table.as_ref()
    }

    /// Decodes bytes of the log and passes completed items to `each`.
    pub fn push(&mut self, bytes: &[u8], mut each: impl FnMut(Decoded)) {
        let table = &self.table;
        self.frames.push(bytes, |stretch| {
            each(match (stretch, table) {
                (LogFrame::Overlong, _) => Decoded::Malformed,
                (LogFrame::Frame(_), None) => Decoded::Unread,
                (LogFrame::Frame(frame), Some(table)) => table
                    .decode(frame)
                    .map_or(Decoded::Malformed, Decoded::Message),
            });
        });
    }

    /// Reports a loss of whole frames: the frame under way is dropped.
    pub fn lost(&mut self) {
        self.frames.gap(true);
    }
}
