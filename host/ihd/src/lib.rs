//! The `ihd` command: identifies an induction hob's load and updates its controller's lookup.
//!
//! ```text
//!  cli (arguments, one module per subcommand) ──► other crates of the host ──► report (text, JSON, figures)
//!  study (many captures with truth, one table) ────────────────────────────────┘
//! ```

pub mod cli;
pub mod report;
