//! What a person reads or looks at after a command: tables and figures.

#[cfg(feature = "pinn")]
pub mod figure;
pub mod table;
#[cfg(feature = "pinn")]
pub mod training;
