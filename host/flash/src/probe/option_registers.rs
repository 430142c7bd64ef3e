//! Option bytes by the flash controller's registers (RM0440, 3.4.2).

use std::thread;
use std::time::{Duration, Instant};

use probe_rs::MemoryInterface;

use super::attached::ProbeProgrammer;
use super::registers as reg;
use crate::options::OptionBytes;
use crate::programmer::{Doing, ProgramError, Programmer};

/// Writing them takes some 25 ms (DS12288, "Flash memory characteristics").
const WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// The chip and its debug port are back this long after they were loaded.
const BACK_WITHIN: Duration = Duration::from_secs(2);

/// Until the core stands.
const HALTED_WITHIN: Duration = Duration::from_millis(500);

/// What they are.
pub fn read(chip: &mut ProbeProgrammer) -> Result<OptionBytes, ProgramError> {
    let mut options = OptionBytes {
        optr: chip.word(Doing::Reading, reg::OPTR)?,
        wrp: [0; 4],
    };
    for (area, address) in options.wrp.iter_mut().zip(reg::WRP) {
        *area = chip.word(Doing::Reading, address)?;
    }
    Ok(options)
}

/// Writes and loads them; protection against reading is never changed, as neither direction can be undone.
pub fn write(chip: &mut ProbeProgrammer, wanted: &OptionBytes) -> Result<(), ProgramError> {
    let doing = Doing::SettingOptions;
    let now = read(chip)?;
    if (now.optr ^ wanted.optr) & 0xFF != 0 {
        return Err(ProgramError::Unsupported {
            what: "changing the protection against reading",
            way: "with this program",
            instead: "use ST's programmer: one direction erases the chip, the other may be for ever",
        });
    }
    // Halted, no program uses the flash's controller; after a reset it is locked, and takes the keys.
    chip.core(doing, |core| core.reset_and_halt(HALTED_WITHIN))?;
    chip.core(doing, |core| {
        for (register, keys) in [(reg::KEYR, reg::KEYS), (reg::OPTKEYR, reg::OPTION_KEYS)] {
            for key in keys {
                core.write_word_32(register.into(), key)?;
            }
        }
        core.write_word_32(reg::SR.into(), reg::ERRORS)?;
        core.write_word_32(reg::OPTR.into(), wanted.optr)?;
        for ((register, area), before) in reg::WRP.into_iter().zip(wanted.wrp).zip(now.wrp) {
            if area != before {
                core.write_word_32(register.into(), area)?;
            }
        }
        core.write_word_32(reg::CR.into(), reg::OPTSTRT)
    })?;
    await_written(chip)?;
    // The reset comes before the answer does: what this reports means nothing.
    let _ = chip.core(doing, |core| {
        core.write_word_32(reg::CR.into(), reg::OBL_LAUNCH)
    });
    chip.detach();
    let found = reattached(chip)?;
    if found.optr == wanted.optr {
        Ok(())
    } else {
        Err(ProgramError::Options {
            wanted: wanted.optr,
            found: found.optr,
        })
    }
}

fn await_written(chip: &mut ProbeProgrammer) -> Result<(), ProgramError> {
    let (doing, address) = (Doing::SettingOptions, reg::OPTR);
    let deadline = Instant::now() + WRITTEN_WITHIN;
    loop {
        let status = chip.word(doing, reg::SR)?;
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

/// What the chip says once it is back.
fn reattached(chip: &mut ProbeProgrammer) -> Result<OptionBytes, ProgramError> {
    let deadline = Instant::now() + BACK_WITHIN;
    loop {
        match chip.option_bytes() {
            Ok(options) => return Ok(options),
            Err(why) if Instant::now() > deadline => return Err(why),
            Err(_) => {
                chip.detach();
                thread::sleep(Duration::from_millis(50));
            }
        }
    }
}
