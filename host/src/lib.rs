//! Host side of ihd: identifies an induction hob's load and teaches its controller.

pub mod capture;
pub mod cli;
pub mod identify;
pub mod link;
pub mod lookup;
pub mod replay;
pub mod report;
pub mod sim;
pub mod study;
#[cfg(feature = "pinn")]
pub mod trainer;
