//! Study of captures that may mislead `ihd identify`: defects of bench, mains, probes and loads, each processed like by the
//! command. It judges for each if the result is correct, and if a wrong one is reported, or cannot be seen.

mod case;
mod cases;
mod combined;
mod damage;
mod faulty;
pub mod run;
mod score;
pub mod table;

pub use case::{CaptureGroup, Case};
pub use cases::all;
pub use run::{HostilePlan, HostileRun, study};
pub use score::{LIMIT_L_PCT, LIMIT_R_PCT, ResultJudgement};
