//! Study of captures that may mislead `ihd identify`: defects of bench, mains, probes and loads, each processed like by the
//! command. It judges for each if the result is correct, and if a wrong one is reported.

mod case;
mod cases;
mod combined;
mod damage;
mod faulty;
pub mod run;
mod score;
pub mod table;

pub use case::{Case, Group};
pub use cases::all;
pub use run::{Plan, Run, study};
pub use score::{Judgement, LIMIT_L_PCT, LIMIT_R_PCT};
