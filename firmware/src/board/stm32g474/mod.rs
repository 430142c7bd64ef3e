//! STM32G474RE, as on a NUCLEO-G474RE or a B-G474E-DPOW1.
//!
//! ```text
//! PA8, PA9    HRTIM CHA1, CHA2    upper and lower switch of the half-bridge
//! PA0         ADC1 IN1            coil voltage
//! PA1         ADC2 IN2, COMP1+    coil current; COMP1 trips on its positive peak
//! PA7         COMP2+              coil current inverted; COMP2 trips on the other peak
//! PB1, PB0    ADC3 IN1, IN12      bus voltage, mains voltage
//! PA2, PA3    LPUART1             the ST-LINK's serial port of a NUCLEO
//! PA11, PA12  USB                 vendor bulk interface
//! ```
//!
//! Thermistors, fan, panel, LED and the wire to a second zone are where the board's file says.
//!
//! Coil voltage is ADC1 and current ADC2, so that the common data register holds them in the order
//! of a [`ihd_shared::sampling::Pair`], and the DMA writes pairs.
//!
//! It has run on an emulated STM32G474 (tests/stm32g474), not on hardware yet.

mod adc;
mod clock_count;
mod image;
mod led;
mod log;
mod nonvolatile;
mod panel;
mod pins;
mod registers;
pub mod safe_state;
mod self_test;
mod serial;
mod service;
mod share_wire;
mod start;
mod start_up;
mod temperatures;
mod usb;
