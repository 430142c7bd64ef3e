//! Tests of the flash image on the emulated STM32G474. `cargo xtask test --only board` builds the image and sets its path.

mod board;
mod debug_probe;
mod doctor;
#[path = "../../../it/document.rs"]
mod document;
mod heating;
mod link;
mod lock_out;
mod log;
mod lookup;
mod memory;
mod panel;
mod protection;
#[path = "../../../it/scenario_table.rs"]
mod scenario_table;
mod scenarios;
mod self_test;
mod service;
mod share_wire;
mod start;
mod supply;
mod temperatures;
mod timing;
mod wrong_fields;
