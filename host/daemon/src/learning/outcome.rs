//! A window to learn from, and what was found.

use std::time::Duration;

use ihd_link::Window;
use ihd_pinn::Identified;
use ihd_store::{DeviceId, NewResult, SessionId};
use ihd_train::lookup::Built;

/// A window to learn from.
#[derive(Clone, Debug)]
pub struct Task {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The connection that the window came over.
    pub session: SessionId,
    /// The device's boot.
    pub boot: u32,
    /// The window.
    pub window: Box<Window>,
    /// Mean power of its half-cycle in watt, where telemetry told it.
    pub power_w: Option<f64>,
}

/// What became of a window.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The device's name.
    pub device: String,
    /// Its number in the store.
    pub device_id: DeviceId,
    /// The device's boot.
    pub boot: u32,
    /// What the store keeps: the numbers, the gate's verdict and why.
    pub result: NewResult,
    /// A lookup to push.
    pub news: Option<Box<Built>>,
    /// Why the window gives no lookup that a device would take; learning goes on.
    pub no_lookup: Option<String>,
    /// All that was learned of the device, to be stored with the result; only from time to time, but
    /// always with a new lookup and with a frequency that was not seen before.
    pub state: Option<Vec<u8>>,
    /// Time that it took.
    pub busy: Duration,
}

/// What the network says in a few numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers {
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: f64,
    /// The same of L, in henry.
    pub l_h: f64,
    /// Standard deviation of R, in percent.
    pub sigma_r_pct: f64,
    /// Standard deviation of L, in percent.
    pub sigma_l_pct: f64,
    /// Steps of the optimiser.
    pub iterations: u32,
}

impl Numbers {
    /// Where there is no result.
    pub const NONE: Self = Self {
        i_crest_a: f64::NAN,
        r_ohm: f64::NAN,
        l_h: f64::NAN,
        sigma_r_pct: f64::NAN,
        sigma_l_pct: f64::NAN,
        iterations: 0,
    };

    /// Of a result.
    pub fn of(identified: &Identified) -> Self {
        let weights = || identified.i_amplitude_a.iter().map(|i| i * i);
        let all: f64 = weights().sum();
        let mean = |x: &[f64]| weights().zip(x).map(|(w, x)| w * x).sum::<f64>() / all;
        let (sigma_r_pct, sigma_l_pct) = identified
            .relative_sigma_pct()
            .unwrap_or((f64::NAN, f64::NAN));
        Self {
            i_crest_a: identified.i_amplitude_a.iter().copied().fold(0.0, f64::max),
            r_ohm: mean(&identified.r_ohm),
            l_h: mean(&identified.l_h),
            sigma_r_pct,
            sigma_l_pct,
            iterations: u32::try_from(identified.iterations).unwrap_or(u32::MAX),
        }
    }
}
