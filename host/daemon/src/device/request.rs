//! Requests to the task of a device.

use ihd_model::{Command, CommandError, CommandReply};
use tokio::sync::oneshot;

use crate::learning::LookupToPush;
use crate::lease::LeaseId;

/// Request to a device's task.
pub enum DeviceRequest {
    /// Carry out a command.
    Command {
        /// Command.
        command: Command,
        /// Lease of the requester; `None` if the command needs none.
        lease: Option<LeaseId>,
        /// Sender of the outcome.
        reply: ReplySender,
    },
    /// Push a learned lookup.
    PushLookup {
        /// Lookup.
        lookup: Box<LookupToPush>,
        /// Number of times that the device's learning had been forgotten before.
        forgotten_count: u64,
    },
}

/// Sender of a command's outcome.
pub type ReplySender = oneshot::Sender<Result<CommandReply, CommandError>>;
