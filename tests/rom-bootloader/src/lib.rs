#![doc = include_str!("../README.md")]

pub mod bootloader;
pub mod chip;
mod descriptors;
pub mod fault;
mod requests;
#[cfg(test)]
mod tests;

pub use bootloader::{Bootloader, Left, Refused, Status};
pub use chip::Chip;
pub use fault::Fault;
