//! Access to the option bytes through the flash controller's registers (RM0440, 3.4.2).

use std::thread;
use std::time::{Duration, Instant};

use probe_rs::MemoryInterface;

use super::connection::{HALTED_WITHIN, ProbeConnection};
use super::registers as reg;
use crate::options::OptionBytes;
use crate::programmer::{FlashStep, ProgramError};

/// Time limit of writing them; it takes some 25 ms (DS12288, "Flash memory characteristics").
const WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// Time limit for the chip and its debug port to return after loading them.
const BACK_WITHIN: Duration = Duration::from_secs(2);

/// Reads the option bytes.
pub fn read(chip: &mut ProbeConnection) -> Result<OptionBytes, ProgramError> {
    let mut options = OptionBytes {
        optr: chip.read_word(FlashStep::Reading, reg::OPTR)?,
        wrp: [0; 4],
    };
    for (area, address) in options.wrp.iter_mut().zip(reg::WRP) {
        *area = chip.read_word(FlashStep::Reading, address)?;
    }
    Ok(options)
}

/// Writes and loads the option bytes. The read protection is never changed, as neither direction can be undone.
pub fn write(chip: &mut ProbeConnection, target: &OptionBytes) -> Result<(), ProgramError> {
    let doing = FlashStep::SettingOptions;
    let now = read(chip)?;
    if (now.optr ^ target.optr) & 0xFF != 0 {
        return Err(ProgramError::Unsupported {
            what: "changing the protection against reading",
            way: "with this program",
            instead: "use ST's programmer: one direction erases the chip, the other may be for ever",
        });
    }
    // While halted, no program uses the flash's controller; after a reset it is locked and accepts the keys.
    chip.core(doing, |core| core.reset_and_halt(HALTED_WITHIN))?;
    chip.core(doing, |core| {
        for (register, keys) in [(reg::KEYR, reg::KEYS), (reg::OPTKEYR, reg::OPTION_KEYS)] {
            for key in keys {
                core.write_word_32(register.into(), key)?;
            }
        }
        core.write_word_32(reg::SR.into(), reg::ERRORS)?;
        core.write_word_32(reg::OPTR.into(), target.optr)?;
        for ((register, area), before) in reg::WRP.into_iter().zip(target.wrp).zip(now.wrp) {
            if area != before {
                core.write_word_32(register.into(), area)?;
            }
        }
        core.write_word_32(reg::CR.into(), reg::OPTSTRT)
    })?;
    await_written(chip)?;
    // The reset cuts the answer: the error has no meaning.
    let _ = chip.core(doing, |core| {
        core.write_word_32(reg::CR.into(), reg::OBL_LAUNCH)
    });
    chip.detach();
    let actual = reattached(chip)?;
    if actual.optr == target.optr {
        Ok(())
    } else {
        Err(ProgramError::Options {
            expected: target.optr,
            actual: actual.optr,
        })
    }
}

fn await_written(chip: &mut ProbeConnection) -> Result<(), ProgramError> {
    let (doing, address) = (FlashStep::SettingOptions, reg::OPTR);
    let deadline = Instant::now() + WRITTEN_WITHIN;
    loop {
        let status = chip.read_word(doing, reg::SR)?;
        if status & reg::BSY == 0 {
            return match status & reg::ERRORS {
                0 => Ok(()),
                errors => Err(ProgramError::Failed {
                    doing,
                    address,
                    why: reg::errors_of(errors),
                }),
            };
        }
        if Instant::now() > deadline {
            return Err(ProgramError::Stuck {
                doing,
                address,
                status,
            });
        }
        thread::sleep(Duration::from_millis(1));
    }
}

/// Reads the option bytes once the chip is back.
fn reattached(chip: &mut ProbeConnection) -> Result<OptionBytes, ProgramError> {
    let deadline = Instant::now() + BACK_WITHIN;
    loop {
        match read(chip) {
            Ok(options) => return Ok(options),
            Err(why) if Instant::now() > deadline => return Err(why),
            Err(_) => {
                chip.detach();
                thread::sleep(Duration::from_millis(50));
            }
        }
    }
}
