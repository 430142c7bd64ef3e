//! Recording of a device's link: begun by hand, by a fault or by a level, with a pre-trigger.
//!
//! ```text
//!  link's thread ── chunks ──► RecordingSession: ring of the last minute (ring.rs), trigger (trigger.rs)
//!                                 │ armed ──► begun ──► ended: by a limit, by hand
//!                                 └ once begun: the ring, then every chunk ──► the file's thread (writer.rs)
//!                                                                                 └► mcap::SessionRecorder
//! ```
//!
//! A session outlives connections. An armed trigger stays armed; a change while the device was not connected is judged
//! with the first half-cycle after. A recording under way continues in a second file after a reconnect.

mod ring;
mod session;
mod shared;
mod state;
mod trigger;
mod under_way;
mod writer;

pub use ihd_model::{ActiveRecording, Quantity, RecordSettings, RecordingPhase, Trigger};
pub use session::{
    RecordingProgress, RecordingSession, StartedRecording, StoppedRecording, name_of,
};
pub use shared::{RecordingOptions, RecordingSink, RecordingStatus};
pub use under_way::RecordingLimit;
pub use writer::{FreeBytes, MIN_FREE_BYTES};
