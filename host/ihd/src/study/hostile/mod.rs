//! Captures that try to fool `ihd identify`: everything that a bench, a mains, a probe or a load can do to them,
//! each on the very path of the command, and whether it was right, said so, or was wrong in silence.

mod cases;
mod combined;
mod damage;
mod faulty;
pub mod run;
mod score;
pub mod table;

pub use cases::{Case, Group, all};
pub use run::{Plan, Run, study};
pub use score::{Judged, LIMIT_L_PCT, LIMIT_R_PCT};
