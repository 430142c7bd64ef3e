//! The daemon with simulated hobs.

mod fleet;
mod learning;
mod leases;
mod live;
mod lookups;
mod off;
mod recordings;
mod rig;
mod sessions;
mod view;
