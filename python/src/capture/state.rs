//! State of a capture, as `pickle` and `copy` keep it.

use std::collections::BTreeMap;

use ihd_capture::mcap::cdr;
use ihd_signal::{FrequencyStep, TimeBase};
use ihd_survey::Hints;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;

use super::{Capture, Doubles, Singles};
use crate::errors::value;

/// Everything that a capture holds, as a dictionary.
#[derive(FromPyObject, IntoPyObject)]
#[pyo3(from_item_all)]
pub struct State {
    name: String,
    time: Times,
    v: Singles,
    i: Singles,
    full_scale: [Option<f64>; 2],
    f_sw: Vec<(f64, f64)>,
    mains: [Option<f64>; 2],
    /// Messages of the capture file, as a truth holds numbers that are not finite.
    truth: Vec<Vec<u8>>,
    metadata: BTreeMap<String, String>,
    losses: Option<String>,
    wiring: [bool; 2],
}

/// Start and interval, or stamps.
#[derive(FromPyObject, IntoPyObject)]
enum Times {
    Even(f64, f64),
    Stamps(Doubles),
}

/// Returns the state of a capture; it shares the samples.
#[pyfunction]
pub fn state_of(py: Python<'_>, capture: &Bound<'_, Capture>) -> State {
    let Capture {
        facts,
        v,
        i,
        losses,
        wiring,
    } = capture.get();
    State {
        name: facts.name.clone(),
        time: match &facts.time {
            TimeBase::Even { t0_s, dt_s } => Times::Even(*t0_s, *dt_s),
            TimeBase::Stamps(t_s) => Times::Stamps(PyArray1::from_slice(py, t_s).unbind()),
        },
        v: v.clone_ref(py),
        i: i.clone_ref(py),
        full_scale: [facts.v_full_scale_v, facts.i_full_scale_a],
        f_sw: facts.f_sw.iter().map(|s| (s.t_s, s.f_sw_hz)).collect(),
        mains: [facts.mains_hz, facts.zero_crossing_s],
        truth: facts.truth.iter().map(cdr::truth).collect(),
        metadata: facts.metadata.clone(),
        losses: losses.clone(),
        wiring: [wiring.swapped, wiring.inverted],
    }
}

/// Makes a capture of a state.
#[pyfunction]
pub fn restored(py: Python<'_>, state: State) -> PyResult<Capture> {
    let truth = state.truth.iter().map(|message| cdr::read_truth(message));
    let step = |(t_s, f_sw_hz)| FrequencyStep { t_s, f_sw_hz };
    let facts = ihd_signal::Capture {
        name: state.name,
        time: match state.time {
            Times::Even(t0_s, dt_s) => TimeBase::Even { t0_s, dt_s },
            Times::Stamps(t_s) => {
                let t_s = t_s.bind(py).try_readonly().map_err(value)?;
                TimeBase::Stamps(t_s.as_array().to_vec())
            }
        },
        v_full_scale_v: state.full_scale[0],
        i_full_scale_a: state.full_scale[1],
        f_sw: state.f_sw.into_iter().map(step).collect(),
        mains_hz: state.mains[0],
        zero_crossing_s: state.mains[1],
        truth: truth.collect::<Result<_, _>>().map_err(value)?,
        metadata: state.metadata,
        ..ihd_signal::Capture::default()
    };
    let [swapped, inverted] = state.wiring;
    Ok(Capture {
        facts,
        v: state.v,
        i: state.i,
        losses: state.losses,
        wiring: Hints {
            swapped,
            inverted,
            ..Hints::default()
        },
    })
}
