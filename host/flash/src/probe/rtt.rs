//! A board's log through RTT: a ring in its RAM that the probe reads while the program runs.
//!
//! probe-rs has a reader as well, which wants a session, and a session halts the core (see [`super::quiet`]).

use super::quiet::Quiet;
use super::{FoundProbe, Probes, errors};
use crate::log_source::LogSource;
use crate::programmer::{Doing, ProgramError};

/// Variables of the program (memory.x): between the stack and the crash record.
const VARIABLES: std::ops::Range<u32> = 0x2000_4000..0x2001_7FE0;

/// What a control block begins with.
const MAGIC: [u8; 16] = *b"SEGGER RTT\0\0\0\0\0\0";

/// Where in the block the number of rings to the host stands; the rings follow behind that of those from the host.
const UP_RINGS: u32 = 16;
const FIRST_RING: u32 = 24;
/// Name, buffer, size, written, read, flags: words of a ring.
const RING_WORDS: usize = 6;
/// Where in a ring the host says how far it has read.
const READ: u32 = 16;

/// Largest ring that is believed: the RAM has no more.
const MOST_BYTES: u32 = 64 << 10;

/// See [`Probes::log`]. A chip that is reset or whose program has not come as far yet is waited for: reading gives nothing
/// meanwhile. A probe or a supply that goes away is an error, which [`LogSource::resume`] mends once it is back.
#[derive(Debug)]
pub struct RttSource {
    probes: Probes,
    found: FoundProbe,
    named: Option<u32>,
    quiet: Option<Quiet>,
    block: Option<u32>,
}

/// A ring's state, checked: what a chip says is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ring {
    buffer: u32,
    bytes: u32,
    written: u32,
    read: u32,
}

impl Ring {
    fn of(words: [u32; RING_WORDS]) -> Option<Self> {
        let [_, buffer, bytes, written, read, _] = words;
        let lies_in_ram = buffer >= VARIABLES.start
            && bytes <= MOST_BYTES
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

    /// What is unread: up to two stretches, address and length.
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
    pub(super) fn new(probes: Probes, found: FoundProbe, block: Option<u32>) -> Self {
        Self {
            probes,
            found,
            named: block,
            quiet: None,
            block: None,
        }
    }

    /// Reads memory beside the log.
    ///
    /// # Errors
    /// As [`LogSource::read`].
    pub fn memory(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        if self.quiet.is_none() {
            self.resume()?;
        }
        let Some(quiet) = &mut self.quiet else {
            return Ok(());
        };
        quiet.read(address, out).map_err(|why| self.lost(&why))
    }

    fn lost(&mut self, why: &probe_rs::Error) -> ProgramError {
        (self.quiet, self.block) = (None, None);
        errors::lost(Doing::Reading, why)
    }
}

/// Where a control block begins: at the named place or in the program's variables.
fn find(quiet: &mut Quiet, named: Option<u32>) -> Result<Option<u32>, probe_rs::Error> {
    if let Some(named) = named {
        let mut magic = [0; MAGIC.len()];
        quiet.read(named, &mut magic)?;
        return Ok((magic == MAGIC).then_some(named));
    }
    let mut ram = vec![0; VARIABLES.len()];
    quiet.read(VARIABLES.start, &mut ram)?;
    // A word's boundary: the magic's own text in a constant may lie anywhere.
    let mut words = ram.windows(MAGIC.len()).step_by(4);
    let at = words.position(|bytes| bytes == MAGIC);
    Ok(at.map(|word| VARIABLES.start + 4 * word as u32))
}

/// Reads what is unread of the first ring; `None` where there is no sane one (any more).
fn drain(
    quiet: &mut Quiet,
    block: u32,
    out: &mut Vec<u8>,
) -> Result<Option<usize>, probe_rs::Error> {
    let mut magic = [0; MAGIC.len()];
    quiet.read(block, &mut magic)?;
    if magic != MAGIC || quiet.word(block + UP_RINGS)? == 0 {
        return Ok(None);
    }
    let mut words = [0; RING_WORDS];
    quiet.read_words(block + FIRST_RING, &mut words)?;
    let Some(ring) = Ring::of(words) else {
        return Ok(None);
    };
    let mut bytes = Vec::new();
    for (address, length) in ring.unread() {
        let mut stretch = vec![0; length as usize];
        if !stretch.is_empty() {
            quiet.read(address, &mut stretch)?;
        }
        bytes.extend(stretch);
    }
    if !bytes.is_empty() {
        quiet.set_word(block + FIRST_RING + READ, ring.written)?;
    }
    out.extend_from_slice(&bytes);
    Ok(Some(bytes.len()))
}

impl LogSource for RttSource {
    fn describe(&self) -> String {
        format!("RTT through {}", self.found.describe())
    }

    fn read(&mut self, out: &mut Vec<u8>) -> Result<usize, ProgramError> {
        if self.quiet.is_none() {
            self.resume()?;
        }
        let Some(quiet) = &mut self.quiet else {
            return Ok(0);
        };
        let read = match self.block {
            Some(block) => drain(quiet, block, out),
            None => find(quiet, self.named).and_then(|found| {
                self.block = found;
                found.map_or(Ok(None), |block| drain(quiet, block, out))
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

    fn resume(&mut self) -> Result<(), ProgramError> {
        // The old connection first: a probe is opened once at a time.
        (self.quiet, self.block) = (None, None);
        self.quiet = Some(self.probes.quiet(&self.found)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SANE: [u32; RING_WORDS] = [0x0800_1000, 0x2000_5000, 1_024, 10, 4, 0];

    #[test]
    fn what_is_unread_goes_round_the_rings_end() {
        let ring = Ring::of(SANE).unwrap();
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
            Ring::of(words)
        };
        for (at, value) in [
            (1, 0),
            (1, 0x2001_7F00),
            (1, u32::MAX),
            (2, 0),
            (2, u32::MAX),
            (3, 1_024),
            (4, 1_024),
        ] {
            assert_eq!(with(at, value), None, "{at} {value:#x}");
        }
    }
}
