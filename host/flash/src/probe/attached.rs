//! Programmer for a chip behind a debug probe.

use ihd_shared::image::{DEVICE_ID, FLASH_ADDRESS, FLASH_BYTES, FLASH_KIB, PAGE_BYTES};

use super::connection::ProbeConnection;
use super::registers as reg;
use super::running_target::RunningTarget;
use super::{ProbeInfo, Probes, flashing, option_registers};
use crate::image::Image;
use crate::options::{OptionBytes, ReadProtection};
use crate::programmer::{Chip, Erase, FlashStep, ProgramError, Programmer, WriteProgress};

/// See [`Probes::attach`].
#[derive(Debug)]
pub struct ProbeProgrammer {
    connection: ProbeConnection,
}

impl ProbeProgrammer {
    pub(super) fn new(probes: Probes, info: ProbeInfo, target: RunningTarget) -> Self {
        Self {
            connection: ProbeConnection::new(probes, info, target),
        }
    }

    /// The probe.
    pub fn probe(&self) -> &ProbeInfo {
        self.connection.probe()
    }

    /// Checks that the option bytes allow programming, before anything is erased.
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
        self.probe().describe()
    }

    fn identify(&mut self) -> Result<Chip, ProgramError> {
        let doing = FlashStep::Reading;
        let id_code = self.connection.read_word(doing, reg::IDCODE)?;
        if id_code & 0xFFF != DEVICE_ID {
            return Err(ProgramError::WrongChip { id_code });
        }
        match self.option_bytes()?.read_protection() {
            ReadProtection::None => {}
            level => return Err(ProgramError::ReadProtected { level }),
        }
        let flash_kib = self.connection.read_word(doing, reg::FLASH_SIZE)? as u16;
        // The lookup's pages are at the flash's end.
        if flash_kib < FLASH_KIB {
            return Err(ProgramError::SmallChip { flash_kib });
        }
        let mut unique_id = [0; 12];
        self.read(reg::UNIQUE_ID, &mut unique_id)?;
        Ok(Chip {
            id_code: Some(id_code),
            flash_kib,
            unique_id: Some(unique_id),
        })
    }

    fn is_switching(&mut self) -> Result<Option<bool>, ProgramError> {
        let doing = FlashStep::Reading;
        // Without its clock the timer's registers read as arbitrary values.
        let clocked = self.connection.read_word(doing, reg::APB2ENR)? & reg::HRTIM1EN != 0;
        let on = clocked && self.connection.read_word(doing, reg::OENR)? & reg::OUTPUTS != 0;
        Ok(Some(on))
    }

    fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), ProgramError> {
        self.connection.read(FlashStep::Reading, address, out)
    }

    fn option_bytes(&mut self) -> Result<OptionBytes, ProgramError> {
        option_registers::read(&mut self.connection)
    }

    fn set_option_bytes(&mut self, target: &OptionBytes) -> Result<(), ProgramError> {
        option_registers::write(&mut self.connection, target)
    }

    fn flash(
        &mut self,
        image: &Image,
        erase: Erase,
        progress: &mut dyn FnMut(WriteProgress),
    ) -> Result<(), ProgramError> {
        self.check_writable(image, erase)?;
        flashing::flash(&mut self.connection, image, erase, progress)?;
        flashing::verify(&mut self.connection, FLASH_ADDRESS, &image.flat(), progress)
    }

    fn reset(&mut self) -> Result<(), ProgramError> {
        self.connection
            .core(FlashStep::Resetting, |core| core.reset())?;
        // The session's end halts the core once more: now, while the program starts, not later when it may heat.
        self.connection.detach();
        Ok(())
    }
}
