//! Where a log's bytes come from: RTT through a probe, or the link.

use crate::programmer::ProgramError;

/// A running source of the bytes that defmt writes: frames, each ended by a zero.
pub trait LogSource {
    /// The way in words.
    fn describe(&self) -> String;

    /// Appends what has come since; how many bytes that were, 0 where nothing has. Returns at once.
    ///
    /// # Errors
    /// What [`LogSource::resume`] may mend: the probe or the chip are gone.
    fn read(&mut self, out: &mut Vec<u8>) -> Result<usize, ProgramError>;

    /// Tries once to come back after an error: attaches anew, without a reset of the chip.
    ///
    /// # Errors
    /// What still is in the way.
    fn resume(&mut self) -> Result<(), ProgramError>;
}
