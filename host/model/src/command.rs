//! Commands to devices, and their outcomes.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::json_number::{whole_w, whole_w_list};
use crate::recording::RecordSettings;

/// Command to a device. All but [`Command::Off`] and recordings need the lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Heat with a mean power; ends with the lease.
    Power {
        /// Mean power, in watt.
        #[serde(deserialize_with = "whole_w")]
        power_w: u16,
    },
    /// Switch off, and end a sweep. Needs no lease.
    Off,
    /// Leave the safe state after a fault.
    ClearFault,
    /// Push a lookup (`ihd_shared::lookup::RlLookup::to_bytes`).
    LookupPush {
        /// Bytes of the lookup.
        blob: Vec<u8>,
    },
    /// Push an earlier lookup of the store under a new version.
    LookupRollback {
        /// Its version; `None` for the previously active one.
        #[serde(default)]
        version: Option<u32>,
    },
    /// Reset to the built-in lookup; the learned state is discarded.
    LookupReset,
    /// Heat with one power after the other and record windows of each.
    Sweep {
        /// Powers, in watt.
        #[serde(deserialize_with = "whole_w_list")]
        powers_w: Vec<u16>,
    },
    /// Record all messages into an MCAP file in the store's folder `recordings`, now or on a trigger.
    RecordStart(RecordSettings),
    /// End the recording, or disarm it.
    RecordStop,
}

/// Outcome of a command that was carried out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = Done)]
pub struct CommandReply {
    /// Description: `1200 W asked for`; `3000 W asked, 2500 W is the most this hob gives`.
    pub text: String,
    /// Power that the hob took for a request of power, in watt; `null` after any other command.
    #[serde(default)]
    pub granted_w: Option<u16>,
    /// File that was written; `None` if none.
    pub file: Option<String>,
}

impl CommandReply {
    /// Outcome with a description only.
    pub fn with_text(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            granted_w: None,
            file: None,
        }
    }
}

/// Reason why a command was not carried out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[serde(tag = "error", rename_all = "kebab-case")]
pub enum CommandError {
    /// No device of this name.
    #[error("there is no device {name:?}; `ihd device status` shows those that there are")]
    NoDevice {
        /// Requested name.
        name: String,
    },
    /// The device is not connected.
    #[error("{name} is not connected: {detail}")]
    NotConnected {
        /// Name of the device.
        name: String,
        /// Detail of its state.
        detail: String,
    },
    /// Another client holds the lease.
    #[error(
        "{holder} commands {name}, for {expires_in_s} s more unless it is renewed; --force takes it over"
    )]
    Leased {
        /// Name of the device.
        name: String,
        /// Holder of the lease.
        holder: String,
        /// Seconds until the lease ends unless it is renewed.
        expires_in_s: u32,
    },
    /// The device refused, or did not answer.
    #[error("{name}: {why}")]
    Refused {
        /// Name of the device.
        name: String,
        /// Reason.
        why: String,
    },
    /// The daemon failed.
    #[error("{why}")]
    Failed {
        /// Reason.
        why: String,
    },
}
