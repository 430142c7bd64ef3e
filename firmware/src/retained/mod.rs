//! Retained data: what outlives a reset.
//!
//! | module | where | outlives | content |
//! |---|---|---|---|
//! | [`reset`] | four words of RAM | reset | reason of the reset, active fault, number of starts, and [`control`] |
//! | [`control`] | three bytes of these | reset | lock-out, tries used, the panel's setting, key lock, time used unattended |
//! | [`nonvolatile`] | two pages of flash | loss of power | the last good lookup, at most one a minute ([`save_interval`]) |

pub mod control;
pub mod nonvolatile;
pub mod reset;
pub mod save_interval;
