//! Messages between daemon, API, terminal, page and fleet: reports, events, commands, requests, as serialised in JSON.
//!
//! Text received from a device is made printable before it is stored in these types. A name in JSON is a promise to clients: a type or
//! field that is renamed here keeps it (`serde(rename)`, `schema(as = …)`).

mod command;
mod device;
mod event;
mod fleet;
mod history;
mod journal;
mod json_number;
mod live;
mod map;
mod pot_temperature;
mod problem;
mod recording;
mod request;
mod role;
mod store;
mod stored;
mod training;
mod window;

pub use command::{Command, CommandError, CommandReply};
pub use device::{DeviceReport, DeviceState, Identity, Lease, Live, LookupReport, WindowCounts};
pub use event::{DaemonEvent, EventKind};
pub use fleet::{FleetAnswers, FleetDevice, FleetEdge, FleetReport, FleetStates, FleetWorker};
pub use history::{Envelope, History, HistoryResults};
pub use journal::JournalEntry;
pub use live::{LiveDevice, LiveTelemetry};
pub use map::{Hob, Map};
pub use pot_temperature::{PotCurve, PotPoint, PotTemperature};
pub use problem::Problem;
pub use recording::{
    ActiveRecording, Quantity, RecordSettings, RecordingFile, RecordingPhase, Trigger,
};
pub use request::{
    BackupMade, BackupRequest, HOLDER_HEADER, Health, LeaseRequest, MissedEvents, SessionReport,
    SessionRequest,
};
pub use role::Role;
pub use store::{DroppedRecords, RecordKind, StoreCause, StoreFailure};
pub use stored::{StoredLookup, StoredResult};
pub use training::{Fit, FitRemark, FitStep};
pub use window::{Scope, ScopeMeasurement, Trajectory, WindowQuery, WindowSummary};
