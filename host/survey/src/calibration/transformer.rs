//! Droop of a board's current transformer, taken out of captures that the board sampled.

use ihd_signal::{Capture, current_transformer};

use crate::time::runs;

/// Gives the voltage of a capture the droop that its current has, if its metadata says so: R, L and power are then the coil's.
pub fn equalise(capture: &mut Capture) {
    let Some(tau_s) = current_transformer::tau_s(capture) else {
        return;
    };
    for run in runs(capture, &mut Vec::new()) {
        let Some(v) = capture.v_v.get_mut(run.samples) else {
            continue;
        };
        let mut v_v: Vec<f64> = v.iter().map(|v| f64::from(*v)).collect();
        current_transformer::droop(&mut v_v, run.dt_s, tau_s);
        v.iter_mut().zip(v_v).for_each(|(v, x)| *v = x as f32);
    }
    // Once only.
    capture.metadata.remove(current_transformer::METADATA_KEY);
    let text = format!("voltage given the droop of {:.3} ms", 1e3 * tau_s);
    capture
        .metadata
        .insert("current_transformer".to_owned(), text);
}
