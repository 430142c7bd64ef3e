//! Boards: registers, interrupts and the executor, which exist nowhere else.
//!
//! ```text
//! priority   what                                                    may be delayed by
//! hardware   comparator ─► HRTIM fault ─► outputs off                nothing
//! 1          sample source's interrupt (DMA half or complete) and,   critical sections
//!            in it, [`sampling`]: the executor, one poll per block
//! 3          link peripherals (USB, serial)                          the above
//! thread     [`link`]: housekeeping, control, link                   everything
//! ```
//!
//! Budget at the highest frequency, 80 kHz, 170 MHz: a block is 37.5 µs or 6 375 cycles, at 70 kHz
//! 7 286. The sampling task takes the instructions that docs/performance.md states per pair, per
//! phasor and per half-cycle; `cargo xtask test --only cycles` measures them and checks them against
//! firmware/budget.toml. On the STM32 that code runs from CCM SRAM, without wait states, and [`cycles`] measures it. A critical section of the thread is at most one copy
//! of 120 bytes of a window, or of a lookup; with the bridge open a block of a recording.
//!
//! Every decision is in the `ihd_firmware` library; a board moves bytes and sets registers.

#[cfg(feature = "stm32g474")]
mod crash;
mod cycles;
mod dsp;
#[cfg(feature = "instruction-counts")]
mod instruction_counts;
#[cfg(feature = "stm32g474")]
mod link;
mod sampling;
#[cfg(feature = "stm32g474")]
mod stm32g474;
