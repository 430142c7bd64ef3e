//! Drive: state and frequency of the half-bridge from block to block.
//!
//! ```text
//! requested drive ─► sequencer ─► drive in force ─► board
//!                     │ bridge: which state may follow, bootstrap charge, discharged tank
//!                     │ bus_watch: a mains that is away
//!                     └ pwm: grid of frequencies that sampling is locked to
//!                       soft_start: the upper switch's share in the first blocks, for the board
//! ```
//!
//! Ground floor: it uses neither samples nor power.

pub mod bridge;
pub mod bus_watch;
pub mod pwm;
pub mod sequencer;
pub mod soft_start;
