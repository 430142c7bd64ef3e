//! The induction-hob controller, everything that needs no hardware.
//!
//! ```text
//!  pairs ─► demod ─► ekf ─► R, L ─┬─► protection (every block)
//!    │                            ├─► half_cycle ─► control: pot, power ─► drive
//!    └────► recorder (pairs, R, L)┘                     ▲
//!              │                                        │
//!              └────► transmit queue ◄── link ────► lookup, checked
//! ```
//!
//! [`realtime::RealTime`] is what runs in the sampling interrupt: one call per block of 61 sample
//! pairs, no waiting, no panic, no float. [`housekeeping::Housekeeping`] runs below it: link,
//! power control and pot detection, once per half-cycle. The board owns both and nothing else
//! decides anything; the host's simulator is just another board.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod burst;
pub mod channels;
pub mod control;
pub mod conversation;
pub mod demod;
pub mod drive;
pub mod ekf;
pub mod fixed;
pub mod half_cycle;
pub mod health;
pub mod housekeeping;
pub mod impedance;
pub mod limits;
pub mod log_ring;
pub mod mains;
pub mod nonvolatile;
pub mod plausibility;
pub mod pot;
pub mod power;
pub mod protection;
pub mod pwm;
pub mod realtime;
pub mod recorder;
pub mod replay;
pub mod request;
pub mod reset;
pub mod restart;
pub mod ring;
pub mod self_test;
pub mod service;
pub mod soft_limit;
pub mod temperature;
pub mod transmit_queue;
pub mod utilisation;
