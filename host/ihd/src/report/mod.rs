//! Tables and figures of the commands.

pub mod identified;
pub mod recording;
pub mod scenario;
pub mod survey;
pub mod table;
#[cfg(feature = "pinn")]
pub mod trained;
#[cfg(feature = "pinn")]
pub mod training;
pub mod utilisation;
