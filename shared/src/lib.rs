//! Agreement of the ihd firmware and its host, and nothing else: units, ratings of the hob,
//! the sampling grid, wire messages and frames, the layout of windows and replayed
//! blocks, the RL lookup and fault codes.
//!
//! | module | holds |
//! |---|---|
//! | [`units`], [`hob`], [`sampling`] | units, ratings of the hob, the grid of switching and sampling |
//! | [`board`] | values of the board's file |
//! | [`wire`] | messages and frames |
//! | [`window`], [`replay`] | layout of a recorded half-cycle, and of blocks for replay |
//! | [`lookup`] | R and L over frequency and current: layout, checks, the built-in prior |
//! | [`fault`] | numbers, names, class of restart, advice |
//! | [`image`], [`usb`] | marks of an image in flash; USB ids |
//!
//! `no_std`, no allocator, no floating point in anything the firmware calls in its sampling path.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod board;
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
