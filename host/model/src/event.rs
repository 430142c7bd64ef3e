//! Events of the daemon.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::device::{DeviceState, Live};
use crate::recording::RecordingPhase;

/// Event for all subscribers. Records of `…Stored` events are on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Notice)]
pub struct DaemonEvent {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Name of the device; empty for events of the daemon.
    pub device: String,
    /// Kind of the event, with its data.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// Kind of an event, with its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "event", rename_all = "kebab-case")]
#[schema(as = What)]
pub enum EventKind {
    /// The state of the device changed.
    State {
        /// New state.
        state: DeviceState,
        /// Reason of the change.
        detail: String,
    },
    /// A half-cycle; at most ten a second are sent, as many as a display can show.
    Telemetry {
        /// The half-cycle.
        live: Live,
    },
    /// A window was stored.
    WindowStored {
        /// Boot of the device.
        boot: u32,
        /// Number of the window since that boot.
        seq: u32,
    },
    /// A window arrived with a defect and was refused.
    WindowRefused {
        /// Number of the window since the boot.
        seq: u32,
        /// Defect.
        why: String,
    },
    /// A result was stored.
    ResultStored {
        /// Boot of the device.
        boot: u32,
        /// Number of its window since that boot.
        seq: u32,
        /// Switching frequency in hertz.
        f_sw_hz: u32,
        /// Mean of R weighted with the squared current, in ohm.
        r_ohm: f64,
        /// Mean of L weighted with the squared current, in henry.
        l_h: f64,
        /// `true` if it passed the gate.
        pass: bool,
        /// Reason of the refusal; empty if it passed.
        why: String,
    },
    /// A lookup became active on the device and in the store.
    LookupActive {
        /// Version of the lookup.
        version: u32,
        /// Number of cells that rest on observations.
        observed_cells: u32,
    },
    /// The device refused a lookup.
    LookupRefused {
        /// Version of the lookup.
        version: u32,
        /// Reason given by the device.
        why: String,
    },
    /// A fault tripped, or was cleared (number 0).
    Fault {
        /// Number of the fault; 0 if it was cleared.
        fault: u16,
        /// Description.
        text: String,
    },
    /// The pot on the coil changed: it was lifted, or put on.
    Pot {
        /// Pot on the coil, as in [`Live::pot`].
        pot: String,
        /// Description.
        text: String,
    },
    /// The estimate of a pot's temperature rise changed: it is followed, was moved, boils, overheats.
    PotTemperature {
        /// Description.
        text: String,
        /// `true` if it is too hot.
        overheats: bool,
    },
    /// The lease was taken, released or lost.
    Lease {
        /// New holder; empty if none.
        holder: String,
        /// Previous holder if the lease was taken by force; otherwise empty.
        taken_from: String,
        /// Reason if it ended without a release; otherwise empty.
        #[serde(default)]
        why: String,
    },
    /// A command was carried out, or failed.
    Command {
        /// Holder that issued it.
        holder: String,
        /// Description of the command.
        text: String,
        /// `true` if it was carried out.
        ok: bool,
    },
    /// A recording was armed, has begun, or has ended.
    Recording {
        /// New phase.
        phase: RecordingPhase,
        /// Description: trigger, or reason of the end.
        text: String,
        /// Name of its file in the store's folder `recordings`; `None` before it has one.
        file: Option<String>,
    },
    /// The store failed, or works again.
    Store {
        /// Description.
        text: String,
        /// `true` if it works.
        ok: bool,
    },
}
