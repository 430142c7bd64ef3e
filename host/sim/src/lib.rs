//! Simulated hob: loads with known truth, the power stage, the sensing chain, and the firmware lib itself as controller.
//!
//! ```text
//! mains ─► half-bridge ─► C_r, load ─► ADC ─► firmware ─► link
//!              ▲            (truth)              │
//!              └───────────── drive ◄────────────┘
//! ```

pub mod adc;
pub mod behavioural;
pub mod circuit;
pub mod comparator;
pub mod contents;
pub mod cooking;
pub mod dividers;
pub mod front_end;
pub mod hob;
pub mod injection;
pub mod inverter;
mod load_library;
pub mod low_pass;
pub mod mains;
pub mod map_truth;
pub mod meter;
pub mod pace;
pub mod perturbation;
pub mod plant;
pub mod pot;
pub mod recent_truths;
pub mod recording;
pub mod scenario;
pub mod server;
pub mod slow_adc;
pub mod surrogate;
pub mod temperatures;
pub mod thermal_model;
pub mod transport;
pub mod trial;
