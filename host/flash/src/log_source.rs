//! Source of a log's bytes: RTT through a probe, or the link.

use crate::programmer::ProgramError;

/// Open source of the bytes that defmt writes: frames, each ended by a zero.
pub trait LogByteSource {
    /// Description of the access.
    fn describe(&self) -> String;

    /// Appends the bytes received since the last call and returns their number; never waits.
    ///
    /// # Errors
    /// Errors that [`LogByteSource::resume`] may cure: probe or chip are disconnected.
    fn read(&mut self, out: &mut Vec<u8>) -> Result<usize, ProgramError>;

    /// Tries once to reconnect after an error, without a reset of the chip.
    ///
    /// # Errors
    /// The reason why it cannot reconnect.
    fn resume(&mut self) -> Result<(), ProgramError>;
}
