//! Files of a run beside the recording: the pushed lookups.

use std::path::Path;

use ihd_map::MapCell;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, current_a, frequency_hz};
use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE};
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
        f_sw_hz: Vec<f64>,
        i_a: Vec<f64>,
        r_ohm: Vec<Vec<f64>>,
        l_h: Vec<Vec<f64>>,
        confidence: &'a [[f64; CURRENTS]],
        /// Relative standard deviations.
        r_sigma: Vec<Vec<f64>>,
        l_sigma: Vec<Vec<f64>>,
        /// Seconds since a cell was observed last; `None` if it never was.
        age_s: Vec<Vec<Option<f64>>>,
    }
    let cells = |cells: &[[u16; CURRENTS]; FREQUENCIES], unit: f64| {
        cells
            .iter()
            .map(|row| row.iter().map(|&c| f64::from(c) * unit).collect())
            .collect()
    };
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
        f_sw_hz: (0..FREQUENCIES).map(frequency_hz).collect(),
        i_a: (0..CURRENTS).map(current_a).collect(),
        r_ohm: cells(&lookup.r, OHM_PER_CODE),
        l_h: cells(&lookup.l, HENRY_PER_CODE),
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
