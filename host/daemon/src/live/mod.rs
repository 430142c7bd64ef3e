//! Live telemetry: a bounded ring of extremes per device, which each reader polls at its own rate. No reader delays a
//! session.
//!
//! ```text
//! session ─┬► LiveRing (600 buckets of 0.1 s) ◄─ LiveTap of a reader: extremes since its last poll
//!          │  ring.rs                            tap.rs
//!          └► RecentPower: mean power of the last second, in each report
//!             recent_power.rs
//! ```

pub mod recent_power;
pub(crate) mod ring;
mod tap;

pub use tap::LiveTap;
