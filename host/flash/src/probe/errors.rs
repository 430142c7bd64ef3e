//! probe-rs's errors as ours: its own say what its layers saw, not what to do.

use std::error::Error as StdError;

use ihd_signal::printable::printable;
use probe_rs::Error;
use probe_rs::flashing::FlashError;
use probe_rs::probe::DebugProbeError;

use super::FoundProbe;
use crate::programmer::{Doing, ProgramError};

/// An error and its causes, each once.
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
    // probe-rs's sentences have line ends and full stops of their own.
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    printable(text.trim_end_matches('.')).to_string()
}

/// Whether the probe itself is gone, not the chip behind it.
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

/// What went wrong before there was a session.
pub fn attaching(found: &FoundProbe, error: &Error) -> ProgramError {
    match error {
        Error::Probe(DebugProbeError::ProbeCouldNotBeCreated(_)) => ProgramError::Open {
            what: found.describe(),
            why: chain(error),
        },
        _ if is_gone(error) => lost(Doing::Attaching, error),
        _ => ProgramError::NoChip {
            probe: found.describe(),
            why: chain(error),
        },
    }
}

/// An access that failed while something was done.
pub fn access(doing: Doing, error: &Error) -> ProgramError {
    if is_gone(error) {
        lost(doing, error)
    } else {
        ProgramError::Probe {
            doing,
            why: chain(error),
        }
    }
}

/// The connection is gone.
pub fn lost(doing: Doing, error: &dyn StdError) -> ProgramError {
    ProgramError::Lost {
        doing,
        why: chain(error),
    }
}

/// Where flashing stopped, as far as probe-rs tells: what was done, at which address.
pub fn place(error: &FlashError) -> Option<(Doing, u32)> {
    match error {
        FlashError::EraseFailed { sector_address, .. } => {
            Some((Doing::Erasing, *sector_address as u32))
        }
        FlashError::PageWrite { page_address, .. } => {
            Some((Doing::Programming, *page_address as u32))
        }
        FlashError::ChipEraseFailed { .. } => Some((Doing::Erasing, 0x0800_0000)),
        _ => None,
    }
}
