//! Flashing, against models of what is flashed through.

mod dfu;
