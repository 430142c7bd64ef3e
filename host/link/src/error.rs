//! Errors of the link, with advice in their texts.

use std::io;
use std::time::Duration;

use ihd_shared::fault::Fault;
use ihd_shared::lookup::blob::BlobError;
use ihd_shared::lookup::grid::{CURRENTS, current_a, frequency_hz};
use ihd_shared::wire::frame::EncodeError;
use ihd_shared::wire::hello::Mismatch;
use ihd_shared::wire::messages::Outcome;

/// Error of connecting to or using a link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No connection.
    #[error("cannot connect to {device}: {source}{hint}")]
    Connect {
        /// Address of the device.
        device: String,
        /// Advice; begins with "; " or is empty.
        hint: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The device ended the link.
    #[error(
        "{device} closed the link: it ended, or another host has it; connect again once it is free"
    )]
    Closed {
        /// Device in words.
        device: String,
    },
    /// The operating system refused to send or receive.
    #[error("{device}: cannot {doing}: {source}")]
    Io {
        /// Device in words.
        device: String,
        /// "send" or "receive".
        doing: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Device and host speak different protocols.
    #[error("{device} does not fit this host: {why}")]
    Mismatch {
        /// Device in words, with its build if it sent one.
        device: String,
        /// Difference between the two.
        why: Mismatch,
    },
    /// A command got no answer.
    #[error("{device} did not answer {command} within {after:?}; {seen}")]
    NoAnswer {
        /// Device in words.
        device: String,
        /// Name of the command.
        command: &'static str,
        /// Time waited, on the transport's clock.
        after: Duration,
        /// Summary of what was received instead.
        seen: String,
    },
    /// A request to switch off preempted the command.
    #[error("{command} was given up: `off` came before its answer")]
    Preempted {
        /// Name of the command.
        command: &'static str,
    },
    /// The device refused a request.
    #[error("the device refused {command}: {}", outcome_text(*.outcome, *.detail))]
    Refused {
        /// Name of the command.
        command: &'static str,
        /// Outcome in the device's reply.
        outcome: Outcome,
        /// Detail of the outcome; its meaning depends on the outcome.
        detail: u32,
    },
    /// The lookup read from the device fails the checks.
    #[error("the lookup read from {device} is damaged: {source}")]
    DamagedLookup {
        /// Device in words.
        device: String,
        /// Failed check.
        source: BlobError,
    },
    /// The device has left replay mode.
    #[error("{device} is not in replay mode any more; was it reset?")]
    NotReplaying {
        /// Device in words.
        device: String,
    },
    /// The device has replayed a different number of blocks than were sent.
    #[error(
        "{device} has replayed {taken} blocks where {sent} were sent: it does not carry out each \
         request once"
    )]
    OutOfStep {
        /// Device in words.
        device: String,
        /// Blocks that it reports as replayed.
        taken: u32,
        /// Blocks that were sent and answered.
        sent: u32,
    },
    /// A command is too long for a frame.
    #[error("{command} cannot be sent: {source}")]
    Unsendable {
        /// Name of the command.
        command: &'static str,
        /// Reason.
        source: EncodeError,
    },
    /// The client's thread ended in a panic: a bug in this program.
    #[error("the link's thread panicked: this is a fault of this program; connect again")]
    Panicked,
    /// The recording failed and was ended; the link continues.
    #[error("recording stopped, the link goes on: {0}")]
    Recording(io::Error),
}

impl LinkError {
    /// Returns `true` if a cable, a power switch or a reset may be the cause, so that a new link is worth a try.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Connect { .. }
            | Self::Closed { .. }
            | Self::Io { .. }
            | Self::NoAnswer { .. } => true,
            // A reset device has forgotten the handshake.
            Self::Refused { outcome, .. } => *outcome == Outcome::NotPaired,
            _ => false,
        }
    }
}

/// Describes a device's outcome. `detail` is the reply's detail; its meaning depends on the outcome.
pub fn outcome_text(outcome: Outcome, detail: u32) -> String {
    match outcome {
        Outcome::Ok => "done".into(),
        Outcome::Malformed => "it could not decode the message".into(),
        Outcome::UnknownMessage => {
            "it does not know this request: its firmware is older; `ihd flash` brings it up to date"
                .into()
        }
        Outcome::NotPaired => {
            "it has not accepted our hello: protocol versions differ, or it was reset; \
             connect again"
                .into()
        }
        Outcome::PowerOutOfRange => format!("more than may be asked of it: {detail} W"),
        Outcome::FaultActive if detail == 0 => {
            "replay mode locks its power outputs; leave it".into()
        }
        Outcome::FaultActive => {
            let fault = u16::try_from(detail).map(Fault::from_number);
            match fault.ok().and_then(Fault::name) {
                Some(name) => format!("fault {detail} ({name}) is active; clear it first"),
                None => format!("fault {detail} is active; clear it first"),
            }
        }
        Outcome::LookupLength => format!("a lookup has {detail} bytes"),
        Outcome::LookupFormat => format!("it reads lookups of format {detail} only"),
        Outcome::LookupCrc => "the lookup's CRC-32 does not match".into(),
        Outcome::LookupStale => {
            format!("not newer than version {detail}, which it keeps; raise the version")
        }
        Outcome::LookupRange => {
            format!("{} is outside 0.02-15.9 ohm or 2-63.9 µH", cell(detail))
        }
        Outcome::LookupSlope => {
            format!(
                "{} differs from a neighbour by more than a factor 1.6",
                cell(detail)
            )
        }
        Outcome::LookupNotMonotone => format!(
            "{} runs the wrong way with frequency or current by more than 4 %",
            cell(detail)
        ),
        Outcome::LockedOut => {
            let fault = u16::try_from(detail).map_or(Fault::NONE, Fault::from_number);
            format!("it stays off until a person switches its power off and on: {fault}")
        }
        Outcome::LookupStep => {
            format!(
                "too many versions ahead: it takes up to {detail}, or any low one after a reset"
            )
        }
        Outcome::PanelOff => {
            "it was switched off at its panel, by its timer, or by itself after a time without a touch; only the panel switches it on again".into()
        }
        Outcome::OutOfRange => {
            format!("field {detail} of the message is outside its range; nothing was changed")
        }
        Outcome::Busy => {
            "it is busy with one already (a lookup that waits for its half-cycle, or a test of the board); try again"
                .into()
        }
        Outcome::NotIdle => "its inverter is on, or power is asked for; switch it off first, and for the bootloader take the mains off".into(),
        Outcome::NotReplaying => "it is not in replay mode".into(),
        Outcome::Unavailable => {
            "it has not what that takes (a simulated hob has no ROM bootloader, no comparators and no log)".into()
        }
    }
}

fn cell(index: u32) -> String {
    let index = index as usize;
    format!(
        "lookup cell {index} ({:.1} kHz, {:.1} A)",
        frequency_hz(index / CURRENTS) / 1e3,
        current_a(index % CURRENTS)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_outcome_has_its_own_words() {
        let texts: std::collections::BTreeSet<String> =
            Outcome::ALL.iter().map(|&o| outcome_text(o, 7)).collect();
        assert_eq!(texts.len(), Outcome::ALL.len());
    }

    #[test]
    fn a_cell_is_named_by_its_frequency_and_current() {
        let text = outcome_text(Outcome::LookupRange, 7 * 17 + 16);
        assert!(text.contains("80.0 kHz, 80.0 A"), "{text}");
    }
}
