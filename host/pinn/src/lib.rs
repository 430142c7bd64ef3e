//! Physics-informed identification of an induction-hob load.
//!
//! The coil of a hob with a pot above it is a resistance R in series with an inductance L,
//! `v = R(t) i + L(t) di/dt` (paper eq. (1)), and both change with the mains envelope. Given one
//! mains half-cycle of sampled coil voltage and current, [`identify`] returns R(t) and L(t).
//!
//! The method is the paper's hybrid-timescale PINN with two repairs:
//!
//! - the fast **VI branch** is a sum of
//!   switching harmonics whose phasors are cubic B-splines in slow time, so that the data terms
//!   (5), (6) are linear least squares, solved exactly instead of by gradient steps;
//! - the slow **RL-MLP** has softplus outputs *scaled* to ohms and microhenries,
//!   trained on the physics term (4) by Levenberg-Marquardt (or by Adam, for comparison).
//!
//! Both minimise the paper's loss, eq. (7): `L = w_f L_f + w_i (L_i1 + L_i2)`.
//!
//! ```
//! use ihd_pinn::{PinnConfig, Waveform, identify};
//!
//! // One half-cycle of a constant 4 ohm, 20 uH load at 45 kHz, sampled at 45 kHz * 61/3.
//! let (f_sw_hz, dt_s) = (45e3, 3.0 / (61.0 * 45e3));
//! let omega = std::f64::consts::TAU * f_sw_hz;
//! let t: Vec<f64> = (0..9150).map(|n| f64::from(n) * dt_s).collect();
//! let envelope = |t: f64| 40.0 * (std::f64::consts::TAU * 50.0 * t).sin();
//! let slope = |t: f64| 40.0 * std::f64::consts::TAU * 50.0 * (std::f64::consts::TAU * 50.0 * t).cos();
//! let i: Vec<f64> = t.iter().map(|&t| envelope(t) * (omega * t).cos()).collect();
//! let di = |t: f64| slope(t) * (omega * t).cos() - envelope(t) * omega * (omega * t).sin();
//! let v: Vec<f64> = t.iter().zip(&i).map(|(&t, i)| 4.0 * i + 20e-6 * di(t)).collect();
//!
//! let window = Waveform { f_sw_hz, f_mains_hz: 50.0, t0_s: 0.0, dt_s, v_volt: &v, i_ampere: &i };
//! let result = identify(&window, &PinnConfig::default(), &mut |_| {})?;
//! assert!((result.r_at(5e-3) / 4.0 - 1.0).abs() < 0.01);
//! assert!((result.l_at(5e-3) / 20e-6 - 1.0).abs() < 0.01);
//! # Ok::<(), ihd_pinn::PinnError>(())
//! ```

mod adam;
mod at_once;
mod backend;
mod config;
mod config_file;
mod correction;
mod dense;
mod derivatives;
mod embedding;
mod error;
mod harmonic_branch;
mod hybrid;
mod identify;
mod impedance_law;
mod jacobian;
mod levenberg_marquardt;
mod loss;
mod network_jacobian;
mod networks;
mod noise;
mod normal_matrix;
mod optimiser;
mod own_network;
mod parameters;
mod preset;
mod preset_library;
mod progress;
mod result;
mod rl_mlp;
mod slow_inputs;
mod slow_model;
#[cfg(test)]
mod trial;
mod uncertainty;
mod vi_mlp;
mod vi_system;
mod waveform;

pub use backend::Backend;
pub use config::{Optimiser, PinnConfig};
pub use embedding::SlowEmbedding;
pub use error::PinnError;
pub use identify::{IdentifyTask, TruthAt, identify};
pub use impedance_law::{ImpedanceOrder, NamedOrder};
pub use parameters::{Layer, Parameters};
pub use preset::Preset;
pub use preset_library::{NamedConfig, PresetLibrary};
pub use progress::{StopReason, TrainingProgress};
pub use result::{Identification, LossTerms, Reconstruction, ViWaveforms};
pub use slow_inputs::SlowInputs;
pub use vi_mlp::ViMlp;
pub use waveform::Waveform;
