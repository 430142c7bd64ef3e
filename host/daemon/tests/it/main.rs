//! The daemon with simulated hobs.

mod learning;
mod leases;
mod lookups;
mod rig;
mod sessions;
