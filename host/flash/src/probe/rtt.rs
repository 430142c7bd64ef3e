//! A board's log through RTT: a ring in its RAM that the probe reads while the program runs.

use probe_rs::rtt::{Rtt, ScanRegion};
use probe_rs::{MemoryInterface, Session};

use super::{FoundProbe, Probes, errors, registers as reg};
use crate::log_source::LogSource;
use crate::programmer::{Doing, ProgramError};

/// Variables of the program (memory.x): between the stack and the crash record.
const VARIABLES: std::ops::Range<u64> = 0x2000_4000..0x2001_7FE0;

/// Bytes that are read at once; defmt-rtt's ring holds 1 024.
const READ_BYTES: usize = 4_096;

/// See [`Probes::log`]. A chip that is reset or whose program has not come as far yet is waited for: reading gives nothing
/// meanwhile. A probe or a supply that goes away is an error, which [`LogSource::resume`] mends once it is back.
#[derive(Debug)]
pub struct RttSource {
    probes: Probes,
    found: FoundProbe,
    block: Option<u32>,
    session: Option<Session>,
    ring: Option<Rtt>,
}

impl RttSource {
    pub(super) fn new(probes: Probes, found: FoundProbe, block: Option<u32>) -> Self {
        Self {
            probes,
            found,
            block,
            session: None,
            ring: None,
        }
    }

    fn region(&self) -> ScanRegion {
        match self.block {
            Some(address) => ScanRegion::Exact(address.into()),
            None => ScanRegion::range(VARIABLES),
        }
    }

    /// Reads memory beside the log.
    ///
    /// # Errors
    /// As [`LogSource::read`].
    pub fn memory(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        if self.session.is_none() {
            self.resume()?;
        }
        let Some(session) = &mut self.session else {
            return Ok(());
        };
        let read = session
            .core(0)
            .and_then(|mut core| core.read(address.into(), out));
        read.map_err(|why| {
            self.session = None;
            self.ring = None;
            errors::lost(Doing::Reading, &why)
        })
    }

    /// Reads the ring; `None` where there is none, or it was set up anew since.
    fn read_ring(&mut self, out: &mut Vec<u8>) -> Result<Option<usize>, ProgramError> {
        let region = self.region();
        let Some(session) = &mut self.session else {
            return Ok(None);
        };
        let ring = &mut self.ring;
        let read = session.core(0).and_then(|mut core| {
            if ring.is_none() {
                *ring = Rtt::attach_region(&mut core, &region).ok();
            }
            let mut bytes = [0; READ_BYTES];
            let channel = ring.as_mut().and_then(|ring| ring.up_channel(0));
            let read = channel.map(|channel| channel.read(&mut core, &mut bytes));
            if let Some(Ok(count)) = read {
                out.extend_from_slice(bytes.get(..count).unwrap_or_default());
                return Ok(Some(count));
            }
            // No ring yet, or one that a reset has set up anew; whether the chip is there at all, another word tells.
            *ring = None;
            core.read_word_32(reg::IDCODE.into()).map(|_| None)
        });
        read.map_err(|why| {
            self.session = None;
            self.ring = None;
            errors::lost(Doing::Reading, &why)
        })
    }
}

impl LogSource for RttSource {
    fn describe(&self) -> String {
        format!("RTT through {}", self.found.describe())
    }

    fn read(&mut self, out: &mut Vec<u8>) -> Result<usize, ProgramError> {
        if self.session.is_none() {
            self.resume()?;
        }
        Ok(self.read_ring(out)?.unwrap_or(0))
    }

    fn resume(&mut self) -> Result<(), ProgramError> {
        self.session = None;
        self.ring = None;
        self.session = Some(self.probes.reopen(&self.found)?);
        Ok(())
    }
}
