//! The daemon with simulated hobs.

mod fleet;
mod learning;
mod leases;
mod live;

mod looks;
mod lookups;
mod off;
mod recordings;
mod rig;
mod sessions;
