//! Messages of the fleet: windows to workers, answers to edges. CBOR by field (RFC 8949), in a zstd frame with its
//! checksum; states, events and cards are JSON, for people and other programs.
//!
//! A reader ignores fields that it does not know and refuses a message that lacks one it needs, so a field may be added
//! within a version. Anything else is another version: the second token of every subject ([`crate::names::WIRE`]), with a
//! consumer of its own. Bytes of each version are kept in wire/golden.

mod answer;
mod packing;
mod window;

use ihd_daemon::config::is_name;

pub use self::answer::AnswerMessage;
pub use self::packing::MAX_BYTES;
pub use self::window::WindowMessage;

/// Version of the messages.
pub const VERSION: u16 = 2;

/// Error of a message.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Not zstd, truncated or corrupted.
    #[error("it cannot be unpacked: {0}")]
    Packed(std::io::Error),
    /// Not CBOR, or a field is missing or of another type.
    #[error("it cannot be read: {0}")]
    Fields(String),
    /// Another version.
    #[error("it is of version {0}, this ihd reads version {VERSION}")]
    Version(u16),
    /// Invalid name of a hob.
    #[error("it names a hob {0:?}, which cannot be")]
    Hob(String),
    /// Implausible number, text or list.
    #[error("its {field} {why}")]
    Value {
        /// The field.
        field: &'static str,
        /// Reason.
        why: String,
    },
}

impl MessageError {
    fn value(field: &'static str, why: impl Into<String>) -> Self {
        let why = why.into();
        Self::Value { field, why }
    }
}

fn check_version(version: u16) -> Result<(), MessageError> {
    match version {
        VERSION => Ok(()),
        other => Err(MessageError::Version(other)),
    }
}

fn check_hob(hob: String) -> Result<String, MessageError> {
    match is_name(&hob) {
        true => Ok(hob),
        false => Err(MessageError::Hob(hob.chars().take(64).collect())),
    }
}

#[cfg(test)]
pub(crate) mod tests;
