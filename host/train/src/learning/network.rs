//! From a window to R(t) and L(t), and to R and L over current: the network on one half-cycle of the device.

use ihd_identify::network::{informed, waveform};
use ihd_link::Window;
use ihd_pinn::{Config, Identified, PinnError, identify};
use ihd_signal::Segment;

use crate::lookup::LoadCurve;
use crate::lookup::curve::LoadPoint;

/// Trains the network on a window's segment; `on_step` hears of each step. Times of the result count from the
/// window's mains zero crossing, in seconds.
///
/// # Errors
/// [`PinnError`] when the window or the configuration cannot be used.
pub fn identify_window(
    segment: &Segment,
    config: Config,
    on_step: &mut dyn FnMut(&ihd_pinn::Progress),
) -> Result<Identified, PinnError> {
    let config = informed(config, segment);
    let waveform = waveform(segment, (0, segment.len()), segment.zero_crossing_s);
    identify(&waveform, &config, on_step)
}

/// Largest standard deviation of R or L, relative to it, at which a point may teach: where the current
/// goes to zero, noise leaves the network free.
const SURE: f64 = 5e-3;

/// The network's curve over current, where it is sure of R and L.
pub fn load_curve(window: &Window, identified: &Identified) -> LoadCurve {
    let sure = |k: &usize| {
        let within = |sigma: &[f64], x: &[f64]| {
            // A result without deviations is taken as it is.
            sigma.get(*k).is_none_or(|s| *s <= SURE * x[*k])
        };
        within(&identified.r_sigma_ohm, &identified.r_ohm)
            && within(&identified.l_sigma_h, &identified.l_h)
    };
    let point = |k: usize| LoadPoint {
        i_a: identified.i_amplitude_a[k],
        r_ohm: identified.r_ohm[k],
        l_h: identified.l_h[k],
    };
    LoadCurve::from_half_cycle(
        f64::from(window.f_sw_hz),
        (0..identified.r_ohm.len()).filter(sure).map(point),
    )
}
