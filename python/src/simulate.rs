//! Simulated captures with their truth.

use ihd_sim::recording::file::SETTINGS_KEY;
use ihd_sim::recording::run::record;
use ihd_sim::recording::settings::{CaptureSpec, PRESETS};
use pyo3::prelude::*;
use serde_json::{Map, Value};

use crate::capture::Capture;
use crate::errors::value;
use crate::interrupt::interruptible;

/// Names of the presets.
#[pyfunction]
pub fn presets() -> Vec<&'static str> {
    PRESETS.iter().map(|(name, _)| *name).collect()
}

/// Simulates coil voltage and current of a hob.
///
/// `settings` is a JSON object of values over the preset's, as in the metadata `simulation` of a recording.
#[pyfunction]
#[pyo3(signature = (preset, seed, settings))]
pub fn simulate(
    py: Python<'_>,
    preset: &str,
    seed: Option<u64>,
    settings: &str,
) -> PyResult<Capture> {
    let mut spec = with_settings(CaptureSpec::preset(preset).map_err(value)?, settings)?;
    spec.seed = seed.unwrap_or(spec.seed);
    spec.check().map_err(value)?;
    let recording = interruptible(py, |look| record(&spec, |_| look()))?.map_err(value)?;
    let name = format!("ihd simulate {preset}");
    let mut capture = recording.capture(&name);
    let settings = serde_json::to_string(&recording.settings).map_err(value)?;
    capture.metadata.insert(SETTINGS_KEY.to_owned(), settings);
    Ok(Capture::new(py, capture))
}

/// A specification with values of a JSON object in place of its own.
fn with_settings(spec: CaptureSpec, settings: &str) -> PyResult<CaptureSpec> {
    let given: Map<String, Value> = serde_json::from_str(settings).map_err(value)?;
    let mut all = serde_json::to_value(spec).map_err(value)?;
    replace(&mut all, given, "")?;
    serde_json::from_value(all).map_err(value)
}

/// Replaces values; an unknown key is an error, which names the known ones.
fn replace(all: &mut Value, given: Map<String, Value>, inside: &str) -> PyResult<()> {
    for (key, new) in given {
        let known = all.as_object().map(|all| all.keys().cloned());
        let known = known.map(|keys| keys.collect::<Vec<_>>().join(", "));
        let Some(old) = all.get_mut(&key) else {
            let known = known.unwrap_or_default();
            return Err(value(format!(
                "unknown setting {inside}{key}: there are {known}"
            )));
        };
        match new {
            Value::Object(new) if old.is_object() => {
                replace(old, new, &format!("{inside}{key}."))?;
            }
            new => *old = new,
        }
    }
    Ok(())
}
