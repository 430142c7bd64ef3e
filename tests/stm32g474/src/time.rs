//! Emulated time, in ticks of HRTIM: 1/8 of a cycle of 170 MHz. A cycle of the internal 16 MHz oscillator is 85 ticks, so
//! a cycle of every clock of the image is a whole number of ticks.

/// Time or duration, in ticks of 1/1.36 GHz.
pub type Ticks = u64;

/// Ticks in a second.
pub const TICKS_PER_S: u64 = 1_360_000_000;

/// Ticks of a duration in microseconds.
pub const fn us(microseconds: u64) -> Ticks {
    microseconds * (TICKS_PER_S / 1_000_000)
}

/// Duration in seconds.
pub fn seconds(ticks: Ticks) -> f64 {
    ticks as f64 / TICKS_PER_S as f64
}
