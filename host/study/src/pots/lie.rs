//! Worst entry that passes all checks: forged with knowledge of the pot, and of the frequency at which the other hob will first use
//! it.

use ihd_map::PotEntry;
use ihd_map::library::{SHAPE_UNIT, shape_places};
use serde_json::{Value, json};

/// Relative falsification of R and L an octave away from the first window; at that window it is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OctaveError {
    /// Falsification of R.
    pub r: f64,
    /// Falsification of L.
    pub l: f64,
}

/// Largest falsification that the checks of one entry allow.
pub const LARGE: OctaveError = OctaveError { r: 0.15, l: 0.05 };

/// Falsification of a pot that is nearly the same.
pub const SMALL: OctaveError = OctaveError { r: 0.03, l: 0.01 };

/// Returns the falsified entry; `None` if it would not be accepted.
pub fn forged_entry(entry: &PotEntry, first_hz: f64, by: OctaveError) -> Option<PotEntry> {
    let mut lie: Value = serde_json::from_slice(&entry.to_bytes()).ok()?;
    let places = shape_places();
    let shape = lie.get_mut("shape")?.as_array_mut()?;
    for (k, code) in shape.iter_mut().enumerate() {
        let (f_hz, _) = *places.get(k % places.len())?;
        let an_octave = if k < places.len() { by.r } else { by.l };
        let away = an_octave * (f_hz / first_hz).log2();
        *code = json!((code.as_i64()? as f64 + away / SHAPE_UNIT).round() as i64);
    }
    // Confident, and marked as observed everywhere.
    lie["misfit"] = json!([0.06, 0.03]);
    lie["seen"]["f_sw_hz"] = json!([2e4, 1e5]);
    lie["seen"]["i_a"] = json!([0.1, 100.0]);
    PotEntry::from_bytes(&serde_json::to_vec(&lie).ok()?).ok()
}
