//! From a window to R(t) and L(t): the network on one half-cycle of the device.

use ihd_identify::network::{informed, waveform};
use ihd_link::Window;
use ihd_pinn::{Config, Identified, PinnError, identify};

/// Trains the network on a window; `on_step` hears of each step. Times of the result count from the
/// window's mains zero crossing, in seconds.
///
/// # Errors
/// [`PinnError`] when the window or the configuration cannot be used.
pub fn identify_window(
    window: &Window,
    config: Config,
    on_step: &mut dyn FnMut(&ihd_pinn::Progress),
) -> Result<Identified, PinnError> {
    let segment = window.segment();
    let config = informed(config, &segment);
    let waveform = waveform(&segment, (0, segment.len()), segment.zero_crossing_s);
    identify(&waveform, &config, on_step)
}
