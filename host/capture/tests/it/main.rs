//! Captures that were damaged or made to harm.

mod damage;
mod flush;
mod memory;
mod recording_tables;
