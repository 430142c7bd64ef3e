//! What the ihd firmware and its host must agree on, and nothing else: units, ratings of the hob,
//! the sampling grid, wire messages and frames, the layout of windows and replayed
//! blocks, the RL lookup and fault codes.
//!
//! `no_std`, no allocator, no floating point in anything the firmware calls in its sampling path.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod fault;
pub mod hob;
pub mod image;
pub mod lookup;
pub mod replay;
pub mod sampling;
pub mod units;
pub mod usb;
pub mod window;
pub mod wire;
