//! Sampling: the path of a block of 61 sample pairs through the ADC's interrupt, 11 000 to 27 000 times a second.
//!
//! ```text
//! AdcBlock ─► sums ─► trips ─► demodulator ─► EKF ─► checks of R, L ─► soft limits ─► next drive
//!              │                               │
//!              ├─► half_cycle: power, crest    │
//!              └─► recorder: pairs ◄── R, L ───┘
//! ```
//!
//! Nothing here waits, allocates, divides by a variable of 64 bit, uses floating point or can panic. Control and link run
//! below it and reach it through [`path::SamplingLock`].

pub mod half_cycle;
pub mod half_cycle_sums;
pub mod mains_clock;
pub mod packed_blocks;
pub mod path;
pub mod recorder;
pub mod utilisation;
