//! Captures that were damaged or made to harm, exported and read back, and recordings of a simulated hob.

mod damage;
mod flush;
mod memory;
mod npz;
mod parts;
mod recording;
mod recording_tables;
