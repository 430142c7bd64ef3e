//! Captures that were damaged or made to harm, and recordings of a simulated hob.

mod damage;
mod flush;
mod memory;
mod parts;
mod recording;
mod recording_tables;
