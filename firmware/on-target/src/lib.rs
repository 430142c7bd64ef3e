//! Figures that the tests on the controller and on the host compare.
#![no_std]

// Vectors and start-up code; critical sections.
use cortex_m as _;
use cortex_m_rt as _;

pub mod digits;
