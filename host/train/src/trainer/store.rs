//! Files of a run beside the recording: the pushed lookups.

use std::path::Path;

use ihd_map::MapCell;
use ihd_shared::lookup::grid::{CURRENT_KNOTS_A, CURRENTS, FREQUENCIES, FREQUENCY_KNOTS_HZ};
use serde::Serialize;

use super::TrainerError;
use crate::lookup::BuiltLookup;

/// Writes a lookup: its bytes as they were pushed (`lookup-vN.bin`), and readable (`lookup-vN.json`).
///
/// # Errors
/// [`TrainerError::Write`] naming the file.
pub fn save(store: &Path, built: &BuiltLookup) -> Result<(), TrainerError> {
    #[derive(Serialize)]
    struct Readable<'a> {
        version: u32,
        observed_cells: u32,
        f_sw_hz: [f64; FREQUENCIES],
        i_a: [f64; CURRENTS],
        r_ohm: [[f64; CURRENTS]; FREQUENCIES],
        l_h: [[f64; CURRENTS]; FREQUENCIES],
        confidence: &'a [[f64; CURRENTS]],
        /// Relative standard deviations.
        r_sigma: Vec<Vec<f64>>,
        l_sigma: Vec<Vec<f64>>,
        /// Seconds since a cell was observed last; `None` if it never was.
        age_s: Vec<Vec<Option<f64>>>,
    }
    let of = |number: fn(&MapCell) -> f64| {
        built
            .cells
            .iter()
            .map(|row| row.iter().map(number).collect())
            .collect()
    };
    let lookup = &built.lookup;
    let readable = Readable {
        version: lookup.version,
        observed_cells: lookup.observed_cells(),
        f_sw_hz: FREQUENCY_KNOTS_HZ,
        i_a: CURRENT_KNOTS_A,
        r_ohm: lookup.r_ohm(),
        l_h: lookup.l_h(),
        confidence: &built.confidence(),
        r_sigma: of(|cell| cell.value.r_sigma),
        l_sigma: of(|cell| cell.value.l_sigma),
        age_s: built
            .cells
            .iter()
            .map(|row| row.iter().map(|c| c.age_s).collect())
            .collect(),
    };
    let write = |name: String, bytes: &[u8]| {
        let path = store.join(name);
        ihd_signal::atomic::write(&path, bytes).map_err(|source| TrainerError::Write {
            path: path.display().to_string(),
            source,
        })
    };
    write(
        format!("lookup-v{}.bin", lookup.version),
        &lookup.to_bytes(),
    )?;
    let json = serde_json::to_vec_pretty(&readable)
        .map_err(|e| TrainerError::Lookup(format!("cannot be written as JSON: {e}")))?;
    write(format!("lookup-v{}.json", lookup.version), &json)
}
