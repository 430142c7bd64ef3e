//! The induction-hob controller, everything that needs no hardware.
//!
//! Rooms by pace: up to `sampling` once a block in the ADC's interrupt, `control` and `link` once a half-cycle in the thread.
//! A room uses those to its left; `drive`, `limits` and `fixed` lie below all.
//!
//! ```text
//! sense ─► estimate ─► protect ─► sampling ─► control ─► link ─► board (main.rs)
//! drive ────────────────┘
//! ```
//!
//! | room | responsibility |
//! |---|---|
//! | [`sense`] | samples to phasors, zero crossings, bus voltage |
//! | [`estimate`] | R and L from phasors; the resonant tank |
//! | [`drive`] | states of the half-bridge, grid of frequencies |
//! | [`protect`] | trips and soft limits, each block |
//! | [`sampling`] | the path of a block, half-cycles, recorded windows |
//! | [`control`] | state machine, power, pot, bursts, restart |
//! | [`link`] | commands, responses, tests, replay, log |
//! | [`self_test`], [`retained`] | class B checks; what outlives a reset |
//!
//! [`sampling::path::SamplingPath`] takes one block of 61 sample pairs a call: no waiting, no panic, no float.
//! [`link::housekeeping::Housekeeping`] runs below it. The board owns both and decides nothing by itself; the host's simulator
//! is another board.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod control;
pub mod drive;
pub mod estimate;
pub mod fixed;
pub mod limits;
pub mod link;
pub mod protect;
pub mod retained;
pub mod sampling;
pub mod self_test;
pub mod sense;
