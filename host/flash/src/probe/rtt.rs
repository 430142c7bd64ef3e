//! Log of a board through RTT: a ring in its RAM that the probe reads while the program runs.
//!
//! The reader of probe-rs needs a session, which halts the core (see [`super::running_target`]).

use super::running_target::RunningTarget;
use super::{ProbeInfo, Probes, errors};
use crate::programmer::{FlashStep, ProgramError};

/// Address range of the program's variables (memory.x): between the stack and the crash record.
const VARIABLES: std::ops::Range<u32> = 0x2000_3000..0x2001_7FE0;

/// First bytes of a control block.
const MAGIC: [u8; 16] = *b"SEGGER RTT\0\0\0\0\0\0";

/// Number of words of a block up to the end of the first ring: the magic, the numbers of rings to and from the host, then name,
/// buffer, size, written, read and flags of the ring.
const BLOCK_WORDS: usize = 12;

/// Offset in the block of the host's read position.
const READ: u32 = 40;

/// Limit of a plausible ring: the size of the RAM.
const MAX_BYTES: u32 = 64 << 10;

/// See [`Probes::log`]. While a chip is in reset or its program has not initialised the log, reading returns nothing. A
/// disconnected probe or supply is an error, which [`RttSource::resume`] cures once it is back.
#[derive(Debug)]
pub struct RttSource {
    probes: Probes,
    info: ProbeInfo,
    named: Option<u32>,
    target: Option<RunningTarget>,
    block: Option<u32>,
}

/// Validated state of a ring: the chip's values are not trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ring {
    buffer: u32,
    bytes: u32,
    written: u32,
    read: u32,
}

impl Ring {
    fn parse(block: &[u32; BLOCK_WORDS]) -> Option<Self> {
        let [m0, m1, m2, m3, rings, _, _, buffer, bytes, written, read, _] = *block;
        let magic = [m0, m1, m2, m3].map(u32::to_le_bytes);
        if magic.as_flattened() != MAGIC || rings == 0 {
            return None;
        }
        let lies_in_ram = buffer >= VARIABLES.start
            && bytes <= MAX_BYTES
            && buffer
                .checked_add(bytes)
                .is_some_and(|end| end <= VARIABLES.end);
        let is_sane = lies_in_ram && written < bytes && read < bytes;
        is_sane.then_some(Self {
            buffer,
            bytes,
            written,
            read,
        })
    }

    /// Unread bytes: up to two ranges, address and length.
    fn unread(self) -> [(u32, u32); 2] {
        let at = self.buffer + self.read;
        if self.read <= self.written {
            [(at, self.written - self.read), (self.buffer, 0)]
        } else {
            [(at, self.bytes - self.read), (self.buffer, self.written)]
        }
    }
}

impl RttSource {
    pub(super) fn new(probes: Probes, info: ProbeInfo, block: Option<u32>) -> Self {
        Self {
            probes,
            info,
            named: block,
            target: None,
            block: None,
        }
    }

    /// Description of the access.
    pub fn describe(&self) -> String {
        format!("RTT through {}", self.info.describe())
    }

    /// Appends the bytes received since the last call and returns their number; never waits.
    ///
    /// # Errors
    /// Errors that [`RttSource::resume`] may cure: probe or chip are disconnected.
    pub fn read(&mut self, out: &mut Vec<u8>) -> Result<usize, ProgramError> {
        if self.target.is_none() {
            self.resume()?;
        }
        let Some(target) = &mut self.target else {
            return Ok(0);
        };
        let read = match self.block {
            Some(block) => drain(target, block, out),
            None => find(target, self.named).and_then(|at| {
                self.block = at;
                at.map_or(Ok(None), |block| drain(target, block, out))
            }),
        };
        match read {
            Ok(Some(count)) => Ok(count),
            Ok(None) => {
                self.block = None;
                Ok(0)
            }
            Err(why) => Err(self.lost(&why)),
        }
    }

    /// Tries once to reconnect after an error, without a reset of the chip.
    ///
    /// # Errors
    /// The reason why it cannot reconnect.
    pub fn resume(&mut self) -> Result<(), ProgramError> {
        // Disconnects first: a probe is exclusive.
        (self.target, self.block) = (None, None);
        self.target = Some(self.probes.attach_running(&self.info)?);
        Ok(())
    }

    /// Reads memory while following the log.
    ///
    /// # Errors
    /// Any error of [`RttSource::read`].
    pub fn memory(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        if self.target.is_none() {
            self.resume()?;
        }
        let Some(target) = &mut self.target else {
            return Ok(());
        };
        target.read(address, out).map_err(|why| self.lost(&why))
    }

    fn lost(&mut self, why: &probe_rs::Error) -> ProgramError {
        (self.target, self.block) = (None, None);
        errors::lost(FlashStep::Reading, why)
    }
}

/// Address of a control block: at the named place, or found in the program's variables.
fn find(target: &mut RunningTarget, named: Option<u32>) -> Result<Option<u32>, probe_rs::Error> {
    if let Some(named) = named {
        let mut magic = [0; MAGIC.len()];
        target.read(named, &mut magic)?;
        return Ok((magic == MAGIC && named.is_multiple_of(4)).then_some(named));
    }
    let mut ram = vec![0; VARIABLES.len()];
    target.read(VARIABLES.start, &mut ram)?;
    // Words are aligned: a copy of the magic in a constant may be anywhere.
    let mut words = ram.windows(MAGIC.len()).step_by(4);
    let at = words.position(|bytes| bytes == MAGIC);
    Ok(at.map(|word| VARIABLES.start + 4 * word as u32))
}

/// Reads the unread bytes of the first ring; `None` if there is no valid one.
fn drain(
    target: &mut RunningTarget,
    block: u32,
    out: &mut Vec<u8>,
) -> Result<Option<usize>, probe_rs::Error> {
    // One transfer, as each has a cost: this runs fifty times a second.
    let mut words = [0; BLOCK_WORDS];
    target.read_words(block, &mut words)?;
    let Some(ring) = Ring::parse(&words) else {
        return Ok(None);
    };
    let mut bytes = Vec::new();
    for (address, length) in ring.unread() {
        let mut stretch = vec![0; length as usize];
        if !stretch.is_empty() {
            target.read(address, &mut stretch)?;
        }
        bytes.extend(stretch);
    }
    if !bytes.is_empty() {
        target.set_word(block + READ, ring.written)?;
    }
    out.extend_from_slice(&bytes);
    Ok(Some(bytes.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `SEGGER RTT` in words, one ring to the host, none from it, the ring.
    const SANE: [u32; BLOCK_WORDS] = [
        0x4747_4553,
        0x5220_5245,
        0x0000_5454,
        0,
        1,
        0,
        0x0800_1000,
        0x2000_5000,
        1_024,
        10,
        4,
        0,
    ];

    #[test]
    fn what_is_unread_goes_round_the_rings_end() {
        let ring = Ring::parse(&SANE).unwrap();
        assert_eq!(ring.unread(), [(0x2000_5004, 6), (0x2000_5000, 0)]);
        let round = Ring {
            written: 3,
            read: 1_020,
            ..ring
        };
        assert_eq!(round.unread(), [(0x2000_53FC, 4), (0x2000_5000, 3)]);
        let empty = Ring { read: 10, ..ring };
        assert_eq!(empty.unread().map(|(_, length)| length), [0, 0]);
    }

    #[test]
    fn a_ring_that_lies_is_none() {
        let with = |at: usize, value| {
            let mut words = SANE;
            words[at] = value;
            Ring::parse(&words)
        };
        for (at, value) in [
            (0, 0),
            (3, 1),
            (4, 0),
            (7, 0),
            (7, 0x2001_7F00),
            (7, u32::MAX),
            (8, 0),
            (8, u32::MAX),
            (9, 1_024),
            (10, 1_024),
        ] {
            assert_eq!(with(at, value), None, "{at} {value:#x}");
        }
    }
}
