//! Retained data: what outlives a reset.
//!
//! | module | where | outlives | content |
//! |---|---|---|---|
//! | [`reset`] | four words of RAM | reset | reason of the reset, active fault, number of starts |
//! | [`nonvolatile`] | two pages of flash | loss of power | the last good lookup |

pub mod nonvolatile;
pub mod reset;
