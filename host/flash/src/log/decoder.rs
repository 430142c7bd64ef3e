//! From the bytes of a log to messages, and to what of them is none.

use super::frames::{Frames, Stretch};
use super::message::Message;
use super::table::Table;

/// What came in a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    /// A message.
    Message(Message),
    /// A frame that is no message of the image: damaged, or longer than any.
    Malformed,
    /// A frame that nobody can read: there is no table.
    Unread,
}

/// Decodes a log. It holds one frame at most, of [`super::frames::MAX_FRAME`] bytes.
pub struct Decoder {
    table: Option<Table>,
    frames: Frames,
}

impl Decoder {
    /// A decoder of the log of one image; without its table it counts.
    pub fn new(table: Option<Table>) -> Self {
        Self {
            table,
            frames: Frames::default(),
        }
    }

    /// The table that it reads with.
    pub fn table(&self) -> Option<&Table> {
        self.table.as_ref()
    }

    /// Takes bytes of the log, and gives what they complete.
    pub fn push(&mut self, bytes: &[u8], mut each: impl FnMut(Found)) {
        let table = &self.table;
        self.frames.push(bytes, |stretch| {
            each(match (stretch, table) {
                (Stretch::Overlong, _) => Found::Malformed,
                (Stretch::Frame(_), None) => Found::Unread,
                (Stretch::Frame(frame), Some(table)) => {
                    table.decode(frame).map_or(Found::Malformed, Found::Message)
                }
            });
        });
    }

    /// Frames were lost here, as a whole: what was begun is no frame.
    pub fn lost(&mut self) {
        self.frames.gap(true);
    }
}
