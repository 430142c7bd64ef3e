//! What is wrong with a board, and with the machine it is plugged into.
//!
//! ```text
//!  System (this machine, or a test's) ─► machine::checks ─┐
//!  Client ─► firmware::checks, board::checks ─────────────┼─► Report: groups of checks, exit code
//!  Client ─► first_switching ─────────────────────────────┘
//! ```

mod asking;
pub mod board;
pub mod firmware;
pub mod first_switching;
pub mod machine;
pub mod report;

pub use report::{Check, Evidence, Group, Report, Verdict};
