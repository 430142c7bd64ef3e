//! Data model of the daemon: reports, events and commands, as serialised by the API.
//!
//! Text received from a device is made printable before it is stored in these types.

mod fleet;
mod history;
mod journal;
mod live;
mod map;
mod pot_temperature;
mod recording;
mod store;
mod training;
mod window;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use fleet::{FleetAnswers, FleetDevice, FleetEdge, FleetReport, FleetStates, FleetWorker};
pub use history::{Envelope, History, HistoryResults};
pub use journal::JournalEntry;
pub use live::{LiveDevice, LiveTelemetry};
pub use map::{Hob, Map};
pub use pot_temperature::{PotCurve, PotPoint, PotTemperature};
pub use recording::{
    ActiveRecording, Quantity, RecordSettings, RecordingFile, RecordingPhase, Trigger,
};
pub use store::{DroppedRecords, RecordKind, StoreCause, StoreFailure};
pub use training::{Fit, FitRemark, FitStep};
pub use window::{Scope, ScopeMeasurement, Trajectory, WindowQuery, WindowSummary};

/// State of a device in the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceState {
    /// No device answers at the address; the daemon tries again.
    Searching,
    /// Handshake done, no telemetry yet.
    Connected,
    /// Requested to heat, and waiting for a pot.
    WaitingForPot,
    /// Heating; the lookup is updated from its windows.
    Learning,
    /// Connected and not heating.
    Idle,
    /// Off because of a fault.
    Faulted,
    /// Connected, but silent or suspended: the device or the host was asleep.
    Suspended,
    /// Incompatible protocol; `detail` names what to update.
    Incompatible,
}

impl DeviceState {
    /// Returns the name for logs and terminals, which is that of the API.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Connected => "connected",
            Self::WaitingForPot => "waiting-for-pot",
            Self::Learning => "learning",
            Self::Idle => "idle",
            Self::Faulted => "faulted",
            Self::Suspended => "suspended",
            Self::Incompatible => "incompatible",
        }
    }
}

/// Identity of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Identity {
    /// Name and version of the firmware's build.
    pub build: String,
    /// Board.
    pub board: String,
    /// Protocol version, major and minor.
    pub protocol: (u16, u16),
    /// Number of the boot; differs from boot to boot.
    pub boot_id: u32,
    /// Number of the reset reason ([`ihd_shared::wire::hello`]).
    pub reset_reason: u8,
}

/// Last half-cycle reported by a device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Live {
    /// Number of the half-cycle since the boot.
    pub half_cycle: u32,
    /// State of the controller, as named by `ihd_shared::wire::messages::State`.
    pub state: String,
    /// Pot on the coil.
    pub pot: String,
    /// Number of the active fault; 0 if none.
    pub fault: u16,
    /// Description of the fault; empty if none.
    pub fault_text: String,
    /// Limit that holds the power below the requested value.
    pub limit: String,
    /// Requested power, in watt.
    pub asked_w: u16,
    /// Mean power of the half-cycle, in watt.
    pub power_w: f64,
    /// Switching frequency in hertz; 0 if the inverter is off.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// The device's estimate of R at the crest of the current, in ohm.
    pub r_ohm: f64,
    /// The device's estimate of L at the crest of the current, in henry.
    pub l_h: f64,
}

/// Outcomes of all windows that a device has announced: `announced` is the sum of `stored`, `refused`,
/// `dropped_by_device`, `lost`, `not_stored` and the windows in transit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WindowCounts {
    /// Windows recorded by the device, by its own numbering, since the daemon started.
    pub announced: u64,
    /// Windows in the store.
    pub stored: u64,
    /// Windows that arrived with a defect and were refused.
    pub refused: u64,
    /// Windows dropped by the device because its recorder was busy.
    pub dropped_by_device: u64,
    /// Windows lost on the link, or dropped there as being beyond the rate of a hob.
    pub lost: u64,
    /// Windows that arrived whole and were dropped because the store was too slow or full.
    pub not_stored: u64,
    /// Stored windows that passed the gate.
    pub learned: u64,
    /// Stored windows that the gate refused.
    pub unfit: u64,
    /// Stored windows that were dropped from the learner's queue.
    pub unlearned: u64,
}

/// Lookup versions on a device and in the store.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LookupReport {
    /// Version that the device reported last; 0 is the built-in prior.
    pub on_device: Option<u32>,
    /// Version marked active in the store.
    pub active: Option<u32>,
    /// Version marked pending in the store: pushed, or about to be pushed.
    pub pending: Option<u32>,
    /// Number of cells of the active lookup that rest on observations.
    pub observed_cells: u32,
}

/// Lease: the right to command a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// Name of the holder.
    pub holder: String,
    /// Seconds until the lease ends unless it is renewed.
    pub expires_in_s: u32,
}

/// Report of a device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DeviceReport {
    /// Name in the configuration, or address if it has none.
    pub name: String,
    /// Address: `tcp:HOST:PORT`, `usb:SERIAL`, `serial:PATH`, `sim`.
    pub address: String,
    /// USB serial number if the device is addressed by it, otherwise the name: identifies the device in scripts.
    #[serde(default)]
    pub serial: String,
    /// Update needed for firmware and daemon to fit, and the reason; empty if they fit.
    #[serde(default)]
    pub updates_needed: String,
    /// State of the device.
    pub state: DeviceState,
    /// Seconds since the state was entered.
    pub since_s: u64,
    /// Reason of the state, or advice; may be empty.
    pub detail: String,
    /// Identity; `None` before the first handshake.
    pub identity: Option<Identity>,
    /// Last half-cycle; `None` before the first telemetry.
    pub live: Option<Live>,
    /// Lookup versions.
    pub lookup: LookupReport,
    /// Outcomes of its windows.
    pub windows: WindowCounts,
    /// Power requested through the daemon, in watt; 0 if none.
    pub asked_by_daemon_w: u16,
    /// Current lease; `None` if the device is free.
    pub lease: Option<Lease>,
    /// Remaining powers of the running sweep, in watt; empty without one.
    pub sweep_left_w: Vec<u16>,
    /// File of the running recording; `None` without one.
    pub recording: Option<String>,
    /// Recording that is armed or running; `None` without one.
    pub recording_now: Option<ActiveRecording>,
    /// Temperature rise of its pot since it was put on; `None` if unknown.
    #[serde(default)]
    pub pot_temperature: Option<PotTemperature>,
    /// Number of connections since the daemon started.
    pub connections: u32,
    /// Number of frames dropped since then as being beyond the rate of a hob.
    #[serde(default)]
    pub frames_beyond: u64,
}

/// Command to a device. All but [`Command::Off`] and recordings need the lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Heat with a mean power; ends with the lease.
    Power {
        /// Mean power, in watt.
        power_w: u16,
    },
    /// Switch off, and end a sweep. Needs no lease.
    Off,
    /// Leave the safe state after a fault.
    ClearFault,
    /// Push a lookup ([`ihd_shared::lookup::RlLookup::to_bytes`]).
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
    /// Description: `1200 W asked for`.
    pub text: String,
    /// File that was written; `None` if none.
    pub file: Option<String>,
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
