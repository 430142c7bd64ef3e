//! The daemon with simulated hobs.

mod leases;
mod lookups;
mod rig;
mod sessions;
