//! The doctor with simulated hobs, healthy and not, over links that are cut, deaf, and lie.

mod bad_links;
mod board;
mod desk;
mod first_switching;
