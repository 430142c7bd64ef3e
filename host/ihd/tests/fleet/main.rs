//! Tests of the fleet with a real NATS server (installed by `cargo xtask test --only setup`): kills of each process, persistence of JetStream, rights of each
//! key, MQTT.
#![cfg(all(feature = "fleet", target_os = "linux"))]

#[allow(dead_code, reason = "the daemon's tests use all of it")]
#[path = "../daemon/chance.rs"]
mod chance;
mod cut;
mod hour;
mod keyed;
mod lab;
mod lies;
mod limits;
mod mqtt;
mod outages;
#[allow(dead_code, reason = "the daemon's tests use all of it")]
#[path = "../daemon/process.rs"]
mod process;
mod robust;
mod security;
mod server;
mod silence;
mod site;
mod study;
mod twins;
mod watched;
