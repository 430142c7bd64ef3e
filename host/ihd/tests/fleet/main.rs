//! The fleet against a real NATS server (`cargo xtask fleet`): what the engine keeps, what each key may do, MQTT.
#![cfg(all(feature = "fleet", target_os = "linux"))]

mod cut;
mod server;
