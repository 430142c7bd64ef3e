//! The `ihd` command: identifies an induction hob's load and teaches its controller.

pub mod cli;
pub mod report;
pub mod study;
