//! Replay in the loop: a capture through a device's own firmware, and through the host's build of the
//! same firmware, compared bit for bit.
//!
//! ```text
//!  capture ─► stretches of blocks ─┬─► link ─► device's firmware ─► R, L, windows, states ─┐
//!                                  └─► ReferenceDevice (this build) ─► the same ────────────┴─► Outcome
//! ```

pub mod compare;
pub mod reference;
pub mod run;
pub mod stretch;

pub use compare::{Difference, Outcome};
pub use run::{ReplayError, Settings, run};
pub use stretch::Stretch;
