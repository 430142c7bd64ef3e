//! A chip behind a debug probe.

use ihd_shared::image::{DEVICE_ID, FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};
use probe_rs::{Core, MemoryInterface, Session};

use super::quiet::Quiet;
use super::registers as reg;
use super::{FoundProbe, Probes, errors, flashing, option_registers};
use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};
use crate::programmer::{Chip, Doing, Erase, ProgramError, Programmer, Progress};

/// KiB of flash that the firmware needs: the lookup's pages lie at the end of them.
const FLASH_KIB: u16 = 512;

/// How the probe is connected now.
#[derive(Debug)]
enum Connection {
    /// Not at all: a reset may have cut it. The next access connects.
    None,
    /// The debug port alone; the program runs on.
    Quiet(Quiet),
    /// A session of probe-rs, which halts the core at both its ends.
    Session(Box<Session>),
}

/// See [`Probes::attach`].
#[derive(Debug)]
pub struct ProbeProgrammer {
    probes: Probes,
    found: FoundProbe,
    connection: Connection,
}

impl ProbeProgrammer {
    pub(super) fn new(probes: Probes, found: FoundProbe, quiet: Quiet) -> Self {
        Self {
            probes,
            found,
            connection: Connection::Quiet(quiet),
        }
    }

    /// The probe.
    pub fn probe(&self) -> &FoundProbe {
        &self.found
    }

    /// For what changes the chip: the core is halted.
    pub(super) fn session(&mut self) -> Result<&mut Session, ProgramError> {
        if !matches!(self.connection, Connection::Session(_)) {
            // A probe is opened once at a time.
            self.detach();
            let session = self.probes.session(&self.found)?;
            self.connection = Connection::Session(Box::new(session));
        }
        match &mut self.connection {
            Connection::Session(session) => Ok(session),
            _ => unreachable!("it was just made"),
        }
    }

    /// Lets the probe go; the next access connects anew.
    pub(super) fn detach(&mut self) {
        self.connection = Connection::None;
    }

    /// Does something with the core, in a session.
    pub(super) fn core<T>(
        &mut self,
        doing: Doing,
        work: impl FnOnce(&mut Core<'_>) -> Result<T, probe_rs::Error>,
    ) -> Result<T, ProgramError> {
        let session = self.session()?;
        let done = session.core(0).and_then(|mut core| work(&mut core));
        done.map_err(|why| errors::access(doing, &why))
    }

    fn read_while(
        &mut self,
        doing: Doing,
        address: u32,
        out: &mut [u8],
    ) -> Result<(), ProgramError> {
        if matches!(self.connection, Connection::None) {
            self.connection = Connection::Quiet(self.probes.quiet(&self.found)?);
        }
        match &mut self.connection {
            Connection::Quiet(quiet) => {
                let read = quiet.read(address, out);
                read.map_err(|why| errors::access(doing, &why))
            }
            _ => self.core(doing, |core| core.read(address.into(), out)),
        }
    }

    pub(super) fn word(&mut self, doing: Doing, address: u32) -> Result<u32, ProgramError> {
        if matches!(self.connection, Connection::None) {
            self.connection = Connection::Quiet(self.probes.quiet(&self.found)?);
        }
        match &mut self.connection {
            Connection::Quiet(quiet) => {
                let read = quiet.word(address);
                read.map_err(|why| errors::access(doing, &why))
            }
            _ => self.core(doing, |core| core.read_word_32(address.into())),
        }
    }

    /// Refuses a chip whose option bytes forbid what is wanted, before anything is erased.
    fn check_writable(&mut self, image: &Image, erase: Erase) -> Result<(), ProgramError> {
        let options = self.option_bytes()?;
        match options.read_protection() {
            ReadProtection::None => {}
            level => return Err(ProgramError::ReadProtected { level }),
        }
        if !options.has_two_banks() {
            return Err(ProgramError::OneBank);
        }
        let bytes = match erase {
            Erase::Image => image.bytes,
            Erase::All => FLASH_BYTES,
        };
        let pages_a_bank = FLASH_BYTES / PAGE_BYTES / 2;
        for (bank, first, last) in options.protected_pages() {
            let begins = (bank as u32 * pages_a_bank + first) * PAGE_BYTES;
            if begins < bytes {
                return Err(ProgramError::WriteProtected { bank, first, last });
            }
        }
        Ok(())
    }
}

impl Programmer for ProbeProgrammer {
    fn describe(&self) -> String {
        self.found.describe()
    }

    fn identify(&mut self) -> Result<Chip, ProgramError> {
        let doing = Doing::Reading;
        let found = self.word(doing, reg::IDCODE)?;
        if found & 0xFFF != DEVICE_ID {
            return Err(ProgramError::WrongChip { found });
        }
        match self.option_bytes()?.read_protection() {
            ReadProtection::None => {}
            level => return Err(ProgramError::ReadProtected { level }),
        }
        let flash_kib = self.word(doing, reg::FLASH_SIZE)? as u16;
        if flash_kib < FLASH_KIB {
            return Err(ProgramError::SmallChip { flash_kib });
        }
        let mut unique_id = [0; 12];
        self.read(reg::UNIQUE_ID, &mut unique_id)?;
        Ok(Chip {
            id_code: Some(found),
            flash_kib,
            unique_id: Some(unique_id),
        })
    }

    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError> {
        let doing = Doing::Reading;
        // Without its clock the timer reads as nothing in particular.
        let clocked = self.word(doing, reg::APB2ENR)? & reg::HRTIM1EN != 0;
        let on = clocked && self.word(doing, reg::OENR)? & reg::OUTPUTS != 0;
        Ok(Some(on))
    }

    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        self.read_while(Doing::Reading, address, out)
    }

    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError> {
        option_registers::read(self)
    }

    fn set_option_bytes(&mut self, wanted: &OptionBytes) -> Result<(), ProgramError> {
        option_registers::write(self, wanted)
    }

    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), ProgramError> {
        self.check_writable(image, erase)?;
        flashing::flash(self, image, erase, progress)?;
        flashing::verify(self, FLASH_ADDRESS, &image.flat(), progress)
    }

    fn reset(&mut self) -> Result<(), ProgramError> {
        self.core(Doing::Resetting, |core| core.reset())?;
        // The session's end halts the core once more: now, while the program starts, and not when it may heat.
        self.detach();
        Ok(())
    }
}
