//! Every register that embassy-stm32 does not cover, by the chapter of the reference manual RM0440
//! and the register's name there. Nothing else in the firmware writes to these.
//!
//! HRTIM timer A drives the half-bridge, timer B triggers the ADCs; both count the same ticks, are
//! started by one write and updated at the same moment, so their ratio and phase hold.
//!
//! What a compiler cannot check (trigger and request numbers, which comparator reaches which fault
//! input, pins and thresholds of the comparators) was compared with two independent sources: ST's own
//! drivers (github.com/STMicroelectronics/stm32g4xx-hal-driver: `LL_ADC_REG_TRIG_EXT_HRTIM_TRG1`,
//! `LL_DMAMUX_REQ_ADC1/3`, `LL_COMP_INPUT_PLUS_IO1`, `LL_COMP_INPUT_MINUS_DAC1_CH1/2`,
//! `HRTIM_FAULTSOURCE_INTERNAL`, `HRTIM_FAULTSOURCE_EEVINPUT`, `HRTIM1_EEV2SRC_TIM2_TRGO`) and github.com/stm32-rs/stm32g4xx-hal (`impl_faults!`). It has not
//! run on a board.

pub mod adc;
pub mod bridge;
pub mod clocks;
pub mod comparators;
pub mod dma;
pub mod faults;
pub mod low_speed;
pub mod random;
pub mod sampling_watchdog;
pub mod supply;
pub mod usb_frame;

/// Indices of the timers in HRTIM.
const BRIDGE: usize = 0;
const SAMPLING: usize = 1;
