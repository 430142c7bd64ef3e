//! Replay of a capture through a device's own firmware and through this build of the same firmware, compared bit for bit.
//!
//! ```text
//!  capture ─► stretches of blocks ─┬─► link ─► device's firmware ─► R, L, windows, states ─┐
//!                                  └─► ReferenceDevice (this build) ─► the same ────────────┴─► ReplayReport
//! ```

pub mod compare;
pub mod reference;
pub mod run;
pub mod stretch;

pub use compare::{ReplayDifference, ReplayReport};
pub use run::{ReplayError, ReplayOptions, run};
pub use stretch::{Stretch, board_segments};
