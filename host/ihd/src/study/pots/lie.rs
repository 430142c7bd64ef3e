//! The worst entry that passes every check: made by somebody who knows the pot, and the frequency at which the other hob will see
//! it first.

use ihd_map::PotEntry;
use ihd_map::library::shape_places;
use serde_json::{Value, json};

/// How far R and L are lied about an octave away from the first window, relative; there, not at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnOctave {
    /// Of R.
    pub r: f64,
    /// Of L.
    pub l: f64,
}

/// As far as the checks of one entry let it.
pub const LARGE: AnOctave = AnOctave { r: 0.15, l: 0.05 };

/// A pot that is nearly the one.
pub const SMALL: AnOctave = AnOctave { r: 0.03, l: 0.01 };

/// What an entry keeps its shape in.
const UNIT: f64 = 1e-5;

/// The lie about a pot; `None` where no such entry would be taken.
pub fn told(entry: &PotEntry, first_hz: f64, by: AnOctave) -> Option<PotEntry> {
    let mut lie: Value = serde_json::from_slice(&entry.to_bytes()).ok()?;
    let places = shape_places();
    let shape = lie.get_mut("shape")?.as_array_mut()?;
    for (k, code) in shape.iter_mut().enumerate() {
        let (f_hz, _) = *places.get(k % places.len())?;
        let an_octave = if k < places.len() { by.r } else { by.l };
        let away = an_octave * (f_hz / first_hz).log2();
        *code = json!((code.as_i64()? as f64 + away / UNIT).round() as i64);
    }
    // Sure of itself, and seen by it everywhere.
    lie["misfit"] = json!([0.06, 0.03]);
    lie["seen"]["f_sw_hz"] = json!([2e4, 1e5]);
    lie["seen"]["i_a"] = json!([0.1, 100.0]);
    PotEntry::from_bytes(&serde_json::to_vec(&lie).ok()?).ok()
}
