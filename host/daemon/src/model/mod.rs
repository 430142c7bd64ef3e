//! What the daemon tells and is told: the types behind the API, the event stream and the commands.
//!
//! Text that came from a device is made printable before it is put in here.

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
    Quantity, RecordSettings, RecordingFile, RecordingNow, RecordingPhase, Trigger,
};
pub use store::{Dropped, Record, StoreCause, StoreFailure};
pub use training::{Fit, FitRemark, FitStep};
pub use window::{Measured, Scope, Trajectory, WindowSummary, WindowWanted};

/// What a device is to the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceState {
    /// Nobody answers at its address; the daemon tries again.
    Searching,
    /// Shaken hands with, nothing known of it yet.
    Connected,
    /// Asked to heat, and it waits for a pot.
    WaitingForPot,
    /// It heats, and its windows teach.
    Learning,
    /// It does not heat.
    Idle,
    /// A fault keeps it off.
    Faulted,
    /// Connected, but silent or set aside: it was suspended, or the host was.
    Suspended,
    /// It speaks another protocol; `detail` says what to update.
    Incompatible,
}

impl DeviceState {
    /// Its word in logs and on terminals: that of the API.
    pub fn word(self) -> &'static str {
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

/// Who a device is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Identity {
    /// Name and version of its firmware's build.
    pub build: String,
    /// Its board.
    pub board: String,
    /// Protocol, major and minor.
    pub protocol: (u16, u16),
    /// Differs from boot to boot.
    pub boot_id: u32,
    /// Number of the reset's reason ([`ihd_shared::wire::hello`]).
    pub reset_reason: u8,
}

/// The last half-cycle that a device told of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Live {
    /// Half-cycle since its boot.
    pub half_cycle: u32,
    /// What its controller does, in the words of `ihd_shared::wire::messages::State`.
    pub state: String,
    /// What stands on the coil.
    pub pot: String,
    /// Number of the active fault, 0 for none.
    pub fault: u16,
    /// The fault in words, empty for none.
    pub fault_text: String,
    /// What holds the power below what was asked for.
    pub limit: String,
    /// Power asked for, in watt.
    pub asked_w: u16,
    /// Mean power of the half-cycle, in watt.
    pub power_w: f64,
    /// Switching frequency in hertz, 0 with the inverter off.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// The device's own R at the crest of the current, in ohm.
    pub r_ohm: f64,
    /// The device's own L at the crest of the current, in henry.
    pub l_h: f64,
}

/// Where every window that a device announced has gone. `announced` = `stored` + `refused` + `lost`
/// + those on their way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WindowCounts {
    /// Windows that were due on the device, by its own numbers, since the daemon began.
    pub announced: u64,
    /// In the store.
    pub stored: u64,
    /// Arrived with a defect, and refused for it.
    pub refused: u64,
    /// Dropped by the device, whose recorder was busy.
    pub dropped_by_device: u64,
    /// Lost on the link, or dropped there: one of more than a hob sends.
    pub lost: u64,
    /// Arrived whole, and dropped because the store could not keep up or was full.
    pub not_stored: u64,
    /// Learned from.
    pub learned: u64,
    /// Looked at and found unfit to learn from, by the gate.
    pub unfit: u64,
    /// Stored, and dropped from the queue before anybody could learn from them.
    pub unlearned: u64,
}

/// The lookup of a device, on both sides.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LookupReport {
    /// Version that the device uses, as it said last; 0 is the built-in prior.
    pub on_device: Option<u32>,
    /// Version that the store holds as active.
    pub active: Option<u32>,
    /// Version that the store holds as pending: pushed, or about to be.
    pub pending: Option<u32>,
    /// Cells of the active one that rest on observations.
    pub observed_cells: u32,
}

/// Who may command a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// Name of the holder.
    pub holder: String,
    /// Seconds until it ends unless it is renewed.
    pub expires_in_s: u32,
}

/// A device as the daemon sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DeviceReport {
    /// Its name in the configuration, or its address where it has none.
    pub name: String,
    /// Where it is: `tcp:HOST:PORT`, `usb:SERIAL`, `serial:PATH`, `sim`.
    pub address: String,
    /// Serial number of its USB device where it is addressed by one, else its name: what marks it in scripts.
    #[serde(default)]
    pub serial: String,
    /// What to update where its firmware does not fit this daemon, and why; empty where it fits.
    #[serde(default)]
    pub updates_needed: String,
    /// What it is to the daemon.
    pub state: DeviceState,
    /// Seconds since the state was entered.
    pub since_s: u64,
    /// Why it is in this state, or what to do about it; may be empty.
    pub detail: String,
    /// Who it is; none before the first handshake.
    pub identity: Option<Identity>,
    /// Its last half-cycle; none before the first telemetry.
    pub live: Option<Live>,
    /// Its lookup.
    pub lookup: LookupReport,
    /// Its windows.
    pub windows: WindowCounts,
    /// Power that the daemon has asked of it, in watt; 0 where it has not.
    pub asked_by_daemon_w: u16,
    /// Who may command it now; none where nobody does.
    pub lease: Option<Lease>,
    /// A sweep under way: powers that are still to come, in watt.
    pub sweep_left_w: Vec<u16>,
    /// File that is being recorded into.
    pub recording: Option<String>,
    /// The recording that waits for its trigger, or is under way.
    pub recording_now: Option<RecordingNow>,
    /// How much warmer its pot is than when it was put on; none where nothing is known of it.
    #[serde(default)]
    pub pot_temperature: Option<PotTemperature>,
    /// Connections that were made since the daemon began.
    pub connections: u32,
    /// Frames that were dropped since then because they were more than a hob sends.
    #[serde(default)]
    pub frames_beyond: u64,
}

/// What is asked of a device. All but [`Command::Off`] and recordings need the lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Heat with a mean power; ends with the lease.
    Power {
        /// In watt.
        power_w: u16,
    },
    /// Switch off, and end a sweep. Anybody may.
    Off,
    /// Leave the safe state after a fault.
    ClearFault,
    /// Offer the bytes of a lookup ([`ihd_shared::lookup::RlLookup::to_bytes`]).
    LookupPush {
        /// The bytes.
        blob: Vec<u8>,
    },
    /// Offer an earlier lookup of the store's, under a new version.
    LookupRollback {
        /// Its version; without, the one that was active before.
        #[serde(default)]
        version: Option<u32>,
    },
    /// Back to the built-in lookup; what was learned is forgotten.
    LookupReset,
    /// Heat with one power after the other, a window of each.
    Sweep {
        /// In watt.
        powers_w: Vec<u16>,
    },
    /// Record everything that comes into an MCAP file of the store's folder `recordings`: now, or when something happens.
    RecordStart(RecordSettings),
    /// End the recording, or wait no longer for its trigger.
    RecordStop,
}

/// What became of a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Done {
    /// In words: `1200 W asked for`.
    pub text: String,
    /// File that was written, where one was.
    pub file: Option<String>,
}

/// Why a command was not carried out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[serde(tag = "error", rename_all = "kebab-case")]
pub enum CommandError {
    /// There is no such device.
    #[error("there is no device {name:?}; `ihd device list` shows those that there are")]
    NoDevice {
        /// The name.
        name: String,
    },
    /// The device is not there now.
    #[error("{name} is not connected: {detail}")]
    NotConnected {
        /// The device.
        name: String,
        /// Its state's detail.
        detail: String,
    },
    /// Somebody else commands it.
    #[error(
        "{holder} commands {name}, for {expires_in_s} s more unless it is renewed; --force takes it over"
    )]
    Leased {
        /// The device.
        name: String,
        /// Who holds the lease.
        holder: String,
        /// Seconds until it ends unless it is renewed.
        expires_in_s: u32,
    },
    /// The device said no, or did not answer.
    #[error("{name}: {why}")]
    Refused {
        /// The device.
        name: String,
        /// Its reason.
        why: String,
    },
    /// The daemon itself could not.
    #[error("{why}")]
    Failed {
        /// Why.
        why: String,
    },
}

/// Something that happened, for everybody who watches. What is `…Stored` is on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Notice {
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device, empty where the daemon itself speaks.
    pub device: String,
    /// What.
    #[serde(flatten)]
    pub what: What,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum What {
    /// A device's state changed.
    State {
        /// The new state.
        state: DeviceState,
        /// Why.
        detail: String,
    },
    /// A half-cycle; only as many as a person can see are sent (ten a second).
    Telemetry {
        /// The half-cycle.
        live: Live,
    },
    /// A window is in the store.
    WindowStored {
        /// Boot of the device.
        boot: u32,
        /// Its number since that boot.
        seq: u32,
    },
    /// A window arrived with a defect.
    WindowRefused {
        /// Its number.
        seq: u32,
        /// Why.
        why: String,
    },
    /// A result is in the store.
    ResultStored {
        /// Boot of the device.
        boot: u32,
        /// The window's number.
        seq: u32,
        /// Switching frequency in hertz.
        f_sw_hz: u32,
        /// Mean of R weighted with the squared current, in ohm.
        r_ohm: f64,
        /// The same of L, in henry.
        l_h: f64,
        /// Whether the gate let it pass.
        pass: bool,
        /// Why not; empty where it did.
        why: String,
    },
    /// A lookup is active on the device, and in the store.
    LookupActive {
        /// Its version.
        version: u32,
        /// Cells that rest on observations.
        observed_cells: u32,
    },
    /// The device refused a lookup.
    LookupRefused {
        /// Its version.
        version: u32,
        /// The device's reason.
        why: String,
    },
    /// A fault tripped, or was cleared (number 0).
    Fault {
        /// Its number.
        fault: u16,
        /// In words.
        text: String,
    },
    /// What stands on the coil is another thing: a pot was lifted, or put on.
    Pot {
        /// In the words of [`Live::pot`].
        pot: String,
        /// In words.
        text: String,
    },
    /// What R and L show of a pot: it is followed, was moved, boils, overheats.
    PotTemperature {
        /// In words.
        text: String,
        /// It is too hot.
        overheats: bool,
    },
    /// Somebody took, lost or gave back the lease.
    Lease {
        /// The new holder, empty for nobody.
        holder: String,
        /// From whom it was taken by force, empty otherwise.
        taken_from: String,
        /// Why it ended by itself, empty otherwise.
        #[serde(default)]
        why: String,
    },
    /// A command was carried out, or not.
    Command {
        /// Who asked.
        holder: String,
        /// The command in words.
        text: String,
        /// Whether it was carried out.
        ok: bool,
    },
    /// A recording waits for its trigger, has begun, or has ended.
    Recording {
        /// Which of it.
        phase: RecordingPhase,
        /// In words: by what it was begun, why it ended.
        text: String,
        /// Its file's name in the store's folder `recordings`, once it has one.
        file: Option<String>,
    },
    /// The store had a problem, or is well again.
    Store {
        /// In words.
        text: String,
        /// Whether it is well.
        ok: bool,
    },
}
