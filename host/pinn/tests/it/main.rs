//! Tests of the whole crate in one binary: errors against an exact load, trainings that stop
//! and go on, presets by name, and what is refused.

mod identify;
mod networks;
mod presets;
mod refusals;
mod truth;
