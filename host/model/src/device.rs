//! Devices: state, identity, report.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::pot_temperature::PotTemperature;
use crate::recording::ActiveRecording;

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
    /// Returns `true` if the device is heard now: what it said last is of the present.
    pub fn is_heard(self) -> bool {
        !matches!(self, Self::Searching | Self::Suspended | Self::Incompatible)
    }

    /// All states.
    pub const ALL: [Self; 8] = [
        Self::Searching,
        Self::Connected,
        Self::WaitingForPot,
        Self::Learning,
        Self::Idle,
        Self::Faulted,
        Self::Suspended,
        Self::Incompatible,
    ];

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
    /// Number of the reset reason (`ihd_shared::wire::hello`).
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
    /// Mean power of the last second, in watt: below the least continuous power, most half-cycles have none.
    pub power_w: f64,
    /// Switching frequency in hertz; 0 if the inverter is off.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// The device's estimate of R at the crest of the current, in ohm.
    pub r_ohm: f64,
    /// The device's estimate of L at the crest of the current, in henry.
    pub l_h: f64,
    /// `true` while the glass is hot enough to burn, or nothing is known of it.
    pub glass_hot: bool,
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
    /// Windows that arrived whole and were dropped because the store was too slow or full, or has one of the same boot and number.
    pub not_stored: u64,
    /// Stored windows that passed the gate and were learned from.
    pub learned: u64,
    /// Stored windows that the gate refused.
    pub unfit: u64,
    /// Stored windows that taught nothing: dropped from the learner's queue, or identified too late.
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
    /// Last half-cycle; `None` before the first telemetry, and while the device is not heard.
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
    /// `true` if the last sweep ended after its last power; `false` while one runs, and if one was ended earlier.
    #[serde(default)]
    pub sweep_is_complete: bool,
    /// File of the running recording; `None` without one.
    pub recording: Option<String>,
    /// Recording that is armed or running; `None` without one.
    pub recording_now: Option<ActiveRecording>,
    /// Reason for which the last recording failed; `None` if it has not.
    #[serde(default)]
    pub recording_failure: Option<String>,
    /// Temperature rise of its pot since it was put on; `None` if unknown.
    #[serde(default)]
    pub pot_temperature: Option<PotTemperature>,
    /// Number of connections since the daemon started.
    pub connections: u32,
    /// Number of frames dropped since then as being beyond the rate of a hob.
    #[serde(default)]
    pub frames_beyond: u64,
}
