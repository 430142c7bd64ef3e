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
    PushLookup(Box<LookupToPush>),
}

/// Sender of a command's outcome.
pub type ReplySender = oneshot::Sender<Result<CommandReply, CommandError>>;
