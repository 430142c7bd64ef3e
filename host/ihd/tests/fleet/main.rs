//! The fleet against a real NATS server (`cargo xtask setup` brings it): what is lost when whoever is killed, what the engine keeps, what each key
//! may do, MQTT.
#![cfg(all(feature = "fleet", target_os = "linux"))]

#[allow(dead_code, reason = "the daemon's tests use all of it")]
#[path = "../daemon/chance.rs"]
mod chance;
mod cut;
mod hour;
mod keyed;
mod lab;
mod lies;
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
mod whole;
