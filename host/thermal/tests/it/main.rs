//! A pot's temperature against the simulator.

mod closed_loop;
mod kitchen;
