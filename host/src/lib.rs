//! Host side of ihd: identifies an induction hob's load and teaches its controller.

pub mod capture;
pub mod link;
pub mod lookup;
pub mod sim;
