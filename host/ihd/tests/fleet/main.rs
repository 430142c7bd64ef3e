//! The fleet against a real NATS server (`cargo xtask fleet`): what the engine keeps, what each key may do, MQTT.
#![cfg(all(feature = "fleet", target_os = "linux"))]

mod cut;
mod keyed;
mod lab;
mod mqtt;
mod outages;
#[allow(dead_code, reason = "tests of the daemon use all of it")]
#[path = "../daemon/process.rs"]
mod process;
mod security;
mod server;
