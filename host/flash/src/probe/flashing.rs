//! Erasing, programming and verifying by ST's algorithm, which probe-rs runs on the chip.

use std::time::Duration;

use ihd_shared::image::{FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};
use probe_rs::MemoryInterface;
use probe_rs::flashing::{
    DownloadOptions, FlashError, FlashProgress, ProgressEvent, ProgressOperation,
};

use super::attached::ProbeProgrammer;
use super::errors;
use super::registers as reg;
use crate::image::Image;
use crate::programmer::{Doing, Erase, ProgramError, Progress};

/// Bytes that are read at once for comparing.
const READ_BYTES: usize = 4_096;

/// Bytes around a difference that a message shows.
const SHOWN_BYTES: usize = 8;

/// Until the core stands.
const HALTED_WITHIN: Duration = Duration::from_millis(500);

/// How far it is, from probe-rs's events.
struct Meter<'a> {
    report: &'a mut dyn FnMut(Progress),
    doing: Doing,
    totals: [u32; 2],
    done: [u32; 2],
}

impl<'a> Meter<'a> {
    fn new(image: &Image, erase: Erase, report: &'a mut dyn FnMut(Progress)) -> Self {
        let erased = match erase {
            Erase::Image => image.bytes.next_multiple_of(PAGE_BYTES),
            Erase::All => FLASH_BYTES,
        };
        Self {
            report,
            doing: Doing::Erasing,
            totals: [erased, image.bytes],
            done: [0; 2],
        }
    }

    fn on(&mut self, event: &ProgressEvent) {
        let (operation, bytes) = match event {
            ProgressEvent::Started(operation) => (operation, Some(0)),
            ProgressEvent::Progress {
                operation, size, ..
            } => (operation, u32::try_from(*size).ok()),
            // All of it, however the algorithm counts.
            ProgressEvent::Finished(operation) => (operation, None),
            _ => return,
        };
        let [erased, programmed] = &mut self.done;
        let [to_erase, to_program] = self.totals;
        match operation {
            ProgressOperation::Erase => {
                self.doing = Doing::Erasing;
                let bytes = bytes.unwrap_or(to_erase);
                *erased = erased.saturating_add(bytes).min(to_erase);
                let (done, total) = (*erased, to_erase);
                (self.report)(Progress::Erasing { done, total });
            }
            ProgressOperation::Program => {
                self.doing = Doing::Programming;
                let bytes = bytes.unwrap_or(to_program);
                *programmed = programmed.saturating_add(bytes).min(to_program);
                let (done, total) = (*programmed, to_program);
                (self.report)(Progress::Programming { done, total });
            }
            ProgressOperation::Fill | ProgressOperation::Verify => {}
        }
    }
}

/// Erases and programs.
pub fn flash(
    chip: &mut ProbeProgrammer,
    image: &Image,
    erase: Erase,
    progress: &mut dyn FnMut(Progress),
) -> Result<(), ProgramError> {
    let mut meter = Meter::new(image, erase, progress);
    let session = chip.session()?;
    let mut loader = session.target().flash_loader();
    let done = image
        .segments
        .iter()
        .try_for_each(|segment| loader.add_data(segment.address.into(), &segment.bytes))
        .and_then(|()| {
            let mut options = DownloadOptions::new();
            options.do_chip_erase = erase == Erase::All;
            options.progress = FlashProgress::new(|event| meter.on(&event));
            loader.commit(session, options)
        });
    let doing = meter.doing;
    done.map_err(|why| diagnose(chip, doing, &why))
}

/// Compares the chip's bytes with the image's, by reading them: probe-rs's own says no more than that something differs.
pub fn verify(
    chip: &mut ProbeProgrammer,
    address: u32,
    wanted: &[u8],
    progress: &mut dyn FnMut(Progress),
) -> Result<(), ProgramError> {
    let doing = Doing::Verifying;
    // After a reset no cache of the flash holds what was there before.
    chip.core(doing, |core| core.reset_and_halt(HALTED_WITHIN))?;
    let total = wanted.len() as u32;
    let mut next = address;
    for part in wanted.chunks(READ_BYTES) {
        let mut found = vec![0; part.len()];
        chip.core(doing, |core| core.read(next.into(), &mut found))?;
        if let Some(at) = part
            .iter()
            .zip(&found)
            .position(|(wanted, found)| wanted != found)
        {
            let shown = |bytes: &[u8]| bytes.iter().skip(at).take(SHOWN_BYTES).copied().collect();
            return Err(ProgramError::Verify {
                address: next + at as u32,
                wanted: shown(part),
                found: shown(&found),
            });
        }
        next += part.len() as u32;
        let done = next - address;
        progress(Progress::Verifying { done, total });
    }
    Ok(())
}

/// What probe-rs's error means: the flash's controller tells, where it can still be reached.
fn diagnose(chip: &mut ProbeProgrammer, doing: Doing, error: &FlashError) -> ProgramError {
    let (doing, address) = errors::place(error).unwrap_or((doing, FLASH_ADDRESS));
    let status = chip.core(doing, |core| {
        core.halt(HALTED_WITHIN)?;
        core.read_word_32(reg::SR.into())
    });
    match status {
        Err(_) => errors::lost(doing, error),
        Ok(status) if status & reg::BSY != 0 => ProgramError::Stuck {
            doing,
            address,
            status,
        },
        Ok(status) if status & reg::ERRORS != 0 => ProgramError::Failed {
            doing,
            address,
            why: reg::errors_of(status),
        },
        Ok(_) => ProgramError::Failed {
            doing,
            address,
            why: errors::chain(error),
        },
    }
}
