//! Conversion of probe-rs's errors: its texts describe its layers, not the remedy.

use std::error::Error as StdError;

use ihd_shared::image::FLASH_ADDRESS;
use ihd_signal::printable::printable;
use probe_rs::Error;
use probe_rs::flashing::FlashError;
use probe_rs::probe::DebugProbeError;

use super::ProbeInfo;
use crate::programmer::{FlashStep, ProgramError};

/// Text of an error and its causes, each once.
pub fn chain(error: &dyn StdError) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(one) = cause {
        let more = one.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = one.source();
    }
    // Texts of probe-rs contain line ends and full stops.
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    printable(text.trim_end_matches('.')).to_string()
}

/// Returns `true` if the probe itself is disconnected, not the chip behind it.
fn is_gone(error: &(dyn StdError + 'static)) -> bool {
    let mut next = Some(error);
    while let Some(one) = next {
        if let Some(DebugProbeError::Usb(_)) = one.downcast_ref() {
            return true;
        }
        if one.is::<std::io::Error>() {
            return true;
        }
        next = one.source();
    }
    false
}

/// Error of attaching.
pub fn attaching(info: &ProbeInfo, error: &Error) -> ProgramError {
    match error {
        Error::Probe(DebugProbeError::ProbeCouldNotBeCreated(_)) => ProgramError::Open {
            what: info.describe(),
            why: chain(error),
        },
        _ if is_gone(error) => lost(FlashStep::Attaching, error),
        _ => ProgramError::NoChip {
            probe: info.describe(),
            why: chain(error),
        },
    }
}

/// Error of an access during an operation.
pub fn access(doing: FlashStep, error: &Error) -> ProgramError {
    if is_gone(error) {
        lost(doing, error)
    } else {
        ProgramError::Probe {
            doing,
            why: chain(error),
        }
    }
}

/// Error for a lost connection.
pub fn lost(doing: FlashStep, error: &dyn StdError) -> ProgramError {
    ProgramError::Lost {
        doing,
        why: chain(error),
    }
}

/// Operation and address at which flashing stopped; `None` if probe-rs does not report it.
pub fn place(error: &FlashError) -> Option<(FlashStep, u32)> {
    match error {
        FlashError::EraseFailed { sector_address, .. } => {
            Some((FlashStep::Erasing, *sector_address as u32))
        }
        FlashError::PageWrite { page_address, .. } => {
            Some((FlashStep::Programming, *page_address as u32))
        }
        FlashError::ChipEraseFailed { .. } => Some((FlashStep::Erasing, FLASH_ADDRESS)),
        _ => None,
    }
}
