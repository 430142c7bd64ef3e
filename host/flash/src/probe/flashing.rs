//! Erasing, programming and verifying by ST's algorithm, which probe-rs runs on the chip.

use ihd_shared::image::{FLASH_ADDRESS, FLASH_BYTES, PAGE_BYTES};
use probe_rs::MemoryInterface;
use probe_rs::Session;
use probe_rs::flashing::{
    self, DownloadOptions, FlashError, FlashProgress, ProgressEvent, ProgressOperation,
};

use super::connection::{HALTED_WITHIN, ProbeConnection};
use super::errors;
use super::registers as reg;
use crate::image::Image;
use crate::programmer::{Erase, FlashStep, ProgramError, WriteProgress};

/// Number of bytes read at once for comparing.
const READ_BYTES: usize = 4_096;

/// Number of bytes after a difference that a message shows.
const SHOWN_BYTES: usize = 8;

/// Progress, from probe-rs's events.
struct Meter<'a> {
    report: &'a mut dyn FnMut(WriteProgress),
    doing: FlashStep,
    totals: [u32; 2],
    done: [u32; 2],
}

impl<'a> Meter<'a> {
    fn new(image: &Image, erase: Erase, report: &'a mut dyn FnMut(WriteProgress)) -> Self {
        let erased = match erase {
            Erase::Image => image.bytes.next_multiple_of(PAGE_BYTES),
            Erase::All => FLASH_BYTES,
        };
        Self {
            report,
            doing: FlashStep::Erasing,
            totals: [erased, image.bytes],
            done: [0; 2],
        }
    }

    fn on(&mut self, event: &ProgressEvent) {
        match event {
            ProgressEvent::Progress {
                operation, size, ..
            } => self.advance(*operation, u32::try_from(*size).unwrap_or(u32::MAX)),
            // Erasing the whole chip is one step; programming has two parts.
            ProgressEvent::Finished(operation @ ProgressOperation::Erase) => {
                self.advance(*operation, u32::MAX);
            }
            ProgressEvent::Started(operation) => self.advance(*operation, 0),
            _ => {}
        }
    }

    /// Adds progress. The algorithm pads the last page: only the image's bytes count.
    fn advance(&mut self, operation: ProgressOperation, bytes: u32) {
        let ([erased, programmed], [to_erase, to_program]) = (&mut self.done, self.totals);
        match operation {
            ProgressOperation::Erase => {
                *erased = erased.saturating_add(bytes).min(to_erase);
                let (done, total) = (*erased, to_erase);
                (self.report)(WriteProgress::Erasing { done, total });
            }
            ProgressOperation::Program => {
                self.doing = FlashStep::Programming;
                *programmed = programmed.saturating_add(bytes).min(to_program);
                let (done, total) = (*programmed, to_program);
                (self.report)(WriteProgress::Programming { done, total });
            }
            ProgressOperation::Fill | ProgressOperation::Verify => {}
        }
    }

    /// Current operation and address, as far as reported.
    fn place(&self) -> (FlashStep, u32) {
        let [erased, programmed] = self.done;
        match self.doing {
            FlashStep::Erasing => (FlashStep::Erasing, FLASH_ADDRESS + erased),
            doing => (doing, FLASH_ADDRESS + programmed),
        }
    }
}

/// Erases and programs, the first page last: after an interruption there are no vectors, so the core does not start an incomplete
/// program.
pub fn flash(
    chip: &mut ProbeConnection,
    image: &Image,
    erase: Erase,
    progress: &mut dyn FnMut(WriteProgress),
) -> Result<(), ProgramError> {
    let flat = image.flat();
    let (first, rest) = flat.split_at(flat.len().min(PAGE_BYTES as usize));
    let mut meter = Meter::new(image, erase, progress);
    let session = chip.session()?;
    let done = erase_pages(session, image, erase, &mut meter)
        .and_then(|()| program(session, FLASH_ADDRESS + PAGE_BYTES, rest, &mut meter))
        .and_then(|()| program(session, FLASH_ADDRESS, first, &mut meter));
    let place = meter.place();
    done.map_err(|why| diagnose(chip, place, &why))?;
    meter.advance(ProgressOperation::Program, u32::MAX);
    Ok(())
}

fn erase_pages(
    session: &mut Session,
    image: &Image,
    erase: Erase,
    meter: &mut Meter<'_>,
) -> Result<(), FlashError> {
    let mut progress = FlashProgress::new(|event| meter.on(&event));
    match erase {
        Erase::Image => {
            let end = FLASH_ADDRESS + image.bytes.next_multiple_of(PAGE_BYTES);
            flashing::erase(
                session,
                &mut progress,
                FLASH_ADDRESS.into(),
                end.into(),
                false,
            )
        }
        Erase::All => flashing::erase_all(session, &mut progress, false),
    }
}

fn program(
    session: &mut Session,
    address: u32,
    bytes: &[u8],
    meter: &mut Meter<'_>,
) -> Result<(), FlashError> {
    if bytes.is_empty() {
        return Ok(());
    }
    let mut loader = session.target().flash_loader();
    loader.add_data(address.into(), bytes)?;
    let mut options = DownloadOptions::new();
    options.skip_erase = true;
    options.progress = FlashProgress::new(|event| meter.on(&event));
    loader.commit(session, options)
}

/// Compares the chip's bytes with the image's by reading them: probe-rs only reports that something differs.
pub fn verify(
    chip: &mut ProbeConnection,
    address: u32,
    expected: &[u8],
    progress: &mut dyn FnMut(WriteProgress),
) -> Result<(), ProgramError> {
    let doing = FlashStep::Verifying;
    // A reset invalidates the caches of the flash.
    chip.core(doing, |core| core.reset_and_halt(HALTED_WITHIN))?;
    let total = expected.len() as u32;
    let mut next = address;
    for part in expected.chunks(READ_BYTES) {
        let mut actual = vec![0; part.len()];
        chip.core(doing, |core| core.read(next.into(), &mut actual))?;
        if let Some(at) = part
            .iter()
            .zip(&actual)
            .position(|(expected, actual)| expected != actual)
        {
            let shown = |bytes: &[u8]| bytes.iter().skip(at).take(SHOWN_BYTES).copied().collect();
            return Err(ProgramError::Verify {
                address: next + at as u32,
                expected: shown(part),
                actual: shown(&actual),
            });
        }
        next += part.len() as u32;
        let done = next - address;
        progress(WriteProgress::Verifying { done, total });
    }
    Ok(())
}

/// Finds the reason of probe-rs's error in the flash controller's status, if that can still be read.
fn diagnose(
    chip: &mut ProbeConnection,
    place: (FlashStep, u32),
    error: &FlashError,
) -> ProgramError {
    let (doing, address) = errors::place(error).unwrap_or(place);
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
