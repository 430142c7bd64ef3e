//! Self-tests after the list of IEC 60730-1, Annex H, for software class B: their decisions, without hardware.
//!
//! ```text
//! image      CRC-32 of the program in flash, in slices         board feeds it each few blocks
//! copies     code, constants and tables in RAM against flash   the same
//! guarded    CRC-32 of the active lookup                       once a second
//! clock      main clock against the watchdog's oscillator      at start and once a second
//! flow       rates of sampling path, housekeeping, keep task   every 100 ms
//! ```
//!
//! Processor, RAM, watchdog, comparators and stack are registers and addresses alone:
//! `board/stm32g474/{start_up,self_test}.rs`.
//! docs/board.md is the table of all of them. Nothing here is certified.

pub mod clock;
pub mod flow;
pub mod guarded;
pub mod heartbeat;
pub mod image;
