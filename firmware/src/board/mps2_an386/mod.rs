//! QEMU's mps2-an386: the same app, the same tasks, the link over its first UART. There is no power
//! stage and nothing to sample; blocks of silence keep the mains half-cycles going, recorded ones
//! come through the link's replay messages.

#[cfg(feature = "instruction-counts")]
mod counting;
#[cfg(feature = "instruction-counts")]
mod float_filter;

#[cfg(not(feature = "instruction-counts"))]
mod blocks;
#[cfg(not(feature = "instruction-counts"))]
mod fault_injection;
#[cfg(not(feature = "instruction-counts"))]
mod start;
#[cfg(not(feature = "instruction-counts"))]
mod uart;
#[cfg(not(feature = "instruction-counts"))]
mod vectors;

pub mod safe_state;
