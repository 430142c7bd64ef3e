//! Diagnosis of a board and of the machine it is connected to: checks with finding, evidence and remedy.
//!
//! ```text
//!  System (this machine, or a test's) ─► machine::checks ─┐
//!  Client ─► firmware::checks, board::checks ─────────────┼─► Report: groups of checks, exit code
//!  Client ─► first_switching ─────────────────────────────┘
//! ```

pub mod board;
mod check_session;
pub mod firmware;
pub mod first_switching;
pub mod machine;
pub mod report;

pub use report::{Check, CheckGroup, CheckResult, Measurement, Report};
