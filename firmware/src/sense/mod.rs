//! Sense: samples to phasors, zero crossings and bus voltage, once a block of 61 sample pairs.
//!
//! ```text
//! ADC ─► dma_buffer ─► correlation ─► demodulator ─► phasors of coil voltage and current ─► estimate
//!        (two halves)       └───────► power, peaks in ADC codes ─► protect, sampling
//! slow ADC ─► mains, bus ─► zero crossing, bus voltage and its ripple
//! reference ─► supply ─► correction of all of them, and of the comparators' thresholds
//! ```

pub mod bus;
pub mod codes;
pub mod correlation;
pub mod current_transformer;
pub mod demodulator;
pub mod dma_buffer;
pub mod mains;
pub mod product_sums;
pub mod supply;
