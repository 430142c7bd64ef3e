//! The store as the daemon uses it, and what is done to it.

mod care;
mod damage;
mod export;
mod fixture;
mod fixture_process;
mod journal;
mod kill;
mod lookups;
mod outbox;
mod power_cut;
mod retention;
mod room;
mod telemetry;
mod windows;
