//! Captures as Python objects. The samples are arrays that Python owns; everything else stays in [`ihd_signal::Capture`].

pub mod state;

use std::collections::BTreeMap;
use std::path::PathBuf;

use ihd_capture::channels::{ChannelOptions, ChannelRef};
use ihd_capture::formats::unit::Unit;
use ihd_capture::mcap::SalvagedCapture;
use ihd_capture::open::salvage_with;
use ihd_capture::{CaptureError as FileError, OpenOptions};
use ihd_identify::accuracy::fundamental;
use ihd_signal::TimeBase;
use ihd_survey::calibration::transformer;
use ihd_survey::{Hints, StatedRange};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, ToPyArray};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::errors::{CaptureError, in_range, value};
use crate::interrupt::interruptible;

type Singles = Py<PyArray1<f32>>;
type Doubles = Py<PyArray1<f64>>;

/// Coil voltage and current, sampled together.
#[pyclass(frozen, module = "ihd._native")]
pub struct Capture {
    /// Everything but the samples, which are `v` and `i`.
    facts: ihd_signal::Capture,
    /// Voltage in volt.
    v: Singles,
    /// Current in ampere.
    i: Singles,
    /// Losses of a damaged file, as a text; `None` for a whole one.
    #[pyo3(get)]
    losses: Option<String>,
    /// Wiring as the user states it.
    wiring: Hints,
}

impl Capture {
    /// Takes over a capture without a copy of its samples; that of a board with the droop of its current transformer in both channels.
    pub fn new(py: Python<'_>, mut facts: ihd_signal::Capture) -> Self {
        transformer::equalise(&mut facts);
        let [v, i] = [&mut facts.v_v, &mut facts.i_a]
            .map(|x| PyArray1::from_vec(py, std::mem::take(x)).unbind());
        Self {
            facts,
            v,
            i,
            losses: None,
            wiring: Hints::default(),
        }
    }

    /// Wiring as the user has stated it at the reading.
    pub fn wiring(&self) -> Hints {
        self.wiring
    }

    /// Copies the capture with its samples.
    pub fn to_signal(&self, py: Python<'_>) -> PyResult<ihd_signal::Capture> {
        let samples = |x: &Singles| -> PyResult<Vec<f32>> {
            let x = x.bind(py).try_readonly().map_err(value)?;
            Ok(x.as_array().to_vec())
        };
        Ok(ihd_signal::Capture {
            v_v: samples(&self.v)?,
            i_a: samples(&self.i)?,
            ..self.facts.clone()
        })
    }

    fn len(&self, py: Python<'_>) -> usize {
        self.v.bind(py).len().unwrap_or(0)
    }
}

#[pymethods]
impl Capture {
    /// Voltage in volt: a new view, whose shape and type are the caller's to change.
    #[getter]
    fn v<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.v.bind(py).call_method0("view")
    }

    /// Current in ampere: a new view.
    #[getter]
    fn i<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.i.bind(py).call_method0("view")
    }

    /// Source: a path, or a description.
    #[getter]
    fn name(&self) -> &str {
        &self.facts.name
    }

    /// Sampling rate in hertz; `None` where the samples are not evenly spaced.
    #[getter]
    fn fs(&self) -> Option<f64> {
        match self.facts.time {
            TimeBase::Even { dt_s, .. } => Some(1.0 / dt_s),
            TimeBase::Stamps(_) => None,
        }
    }

    /// Time of each sample in seconds; a new array.
    #[getter]
    fn t<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        match &self.facts.time {
            TimeBase::Stamps(t_s) => t_s.to_pyarray(py),
            even @ TimeBase::Even { .. } => {
                let times = (0..self.len(py)).filter_map(|k| even.at(k));
                PyArray1::from_iter(py, times)
            }
        }
    }

    /// Switching frequency that the file states, in hertz; `None` if it states none or several.
    #[getter]
    fn f_sw(&self) -> Option<f64> {
        match self.facts.f_sw[..] {
            [only] => Some(only.f_sw_hz),
            _ => None,
        }
    }

    /// Mains frequency that the file states, in hertz.
    #[getter]
    fn f_mains(&self) -> Option<f64> {
        self.facts.mains_hz
    }

    /// Time of a mains zero crossing that the file states, in seconds.
    #[getter]
    fn zero_crossing(&self) -> Option<f64> {
        self.facts.zero_crossing_s
    }

    /// Largest magnitudes of the channels in volt and ampere, beyond which they clip.
    #[getter]
    fn full_scale(&self) -> (Option<f64>, Option<f64>) {
        (self.facts.v_full_scale_v, self.facts.i_full_scale_a)
    }

    /// Further information in the file, as text.
    #[getter]
    fn metadata(&self) -> BTreeMap<String, String> {
        self.facts.metadata.clone()
    }

    /// True time in seconds, R, L and amplitude of the current of a simulation's fundamental; `None` for a measured capture.
    #[getter]
    fn truth(&self, py: Python<'_>) -> Option<[Doubles; 4]> {
        (!self.facts.truth.is_empty()).then(|| {
            let ihd_signal::truth::Truth {
                t_s,
                r_ohm,
                l_h,
                i_a,
                ..
            } = fundamental(&self.facts.truth);
            [t_s, r_ohm, l_h, i_a].map(|x| PyArray1::from_vec(py, x).unbind())
        })
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.len(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let rate = self
            .fs()
            .map_or_else(|| "uneven".to_owned(), |fs| format!("{fs:e} S/s"));
        format!("Capture({:?}, {} × {rate})", self.facts.name, self.len(py))
    }
}

/// Channel by its number or its name.
#[derive(FromPyObject)]
pub enum ChannelName {
    /// Number, from 1.
    Number(usize),
    /// Name.
    Name(String),
}

impl From<ChannelName> for ChannelRef {
    fn from(name: ChannelName) -> Self {
        match name {
            ChannelName::Number(number) => Self::Number(number),
            ChannelName::Name(name) => Self::parse(&name),
        }
    }
}

/// Reads a capture of any format that the program knows.
#[pyfunction]
#[pyo3(signature = (path, second=None, *, channels=None, columns=None, units=None, probe=None, invert="", swap=false, fs=None))]
#[expect(clippy::too_many_arguments, reason = "one for each option of a file")]
pub fn read(
    py: Python<'_>,
    path: PathBuf,
    second: Option<PathBuf>,
    channels: Option<[ChannelName; 2]>,
    columns: Option<[ChannelName; 3]>,
    units: Option<[String; 2]>,
    probe: Option<[f64; 2]>,
    invert: &str,
    swap: bool,
    fs: Option<f64>,
) -> PyResult<Capture> {
    if channels.is_some() && columns.is_some() {
        return Err(value("channels and columns: give one of them"));
    }
    for ratio in probe.into_iter().flatten() {
        in_range("probe", ratio, StatedRange::ProbeRatio)?;
    }
    let [invert_v, invert_i] = inverted(invert)?;
    let options = OpenOptions {
        second,
        channels: ChannelOptions {
            channels: channels.map(|names| names.map(ChannelRef::from)),
            units: units.map(parse_units).transpose()?,
            probe,
            invert_v,
            invert_i,
            swap,
        },
        columns: columns.map(|names| names.map(ChannelRef::from)),
        rate_hz: fs
            .map(|fs| in_range("fs", fs, StatedRange::AboveZero))
            .transpose()?,
    };
    let read = interruptible(py, |look| salvage_with(&path, &options, &mut |_| look()))?;
    let failed = |error: FileError| CaptureError::new_err(error.to_string());
    let SalvagedCapture { capture, losses } = read.map_err(failed)?;
    if capture.is_empty() {
        return Err(failed(FileError::NoSamples { path, losses }));
    }
    Ok(Capture {
        losses: (!losses.is_none()).then(|| losses.to_string()),
        wiring: Hints {
            swapped: swap,
            inverted: invert_v != invert_i,
            ..Hints::default()
        },
        ..Capture::new(py, capture)
    })
}

fn inverted(channels: &str) -> PyResult<[bool; 2]> {
    let known = |c: char| "vi, ".contains(c);
    if !channels.chars().all(known) {
        let text = format!("invert={channels:?}: must be \"v\", \"i\" or \"vi\"");
        return Err(PyValueError::new_err(text));
    }
    Ok(['v', 'i'].map(|channel| channels.contains(channel)))
}

fn parse_units(units: [String; 2]) -> PyResult<[Unit; 2]> {
    let unit = |text: &String| {
        let wrong = || value(format!("units: {text:?} is no unit, as in \"mV\" or \"A\""));
        Unit::parse(text).ok_or_else(wrong)
    };
    Ok([unit(&units[0])?, unit(&units[1])?])
}

/// Makes a capture of arrays of voltage in volt and current in ampere, with `fs` samples a second from `t0` seconds on.
#[pyfunction]
#[pyo3(signature = (v, i, fs, *, t0=0.0, name="arrays"))]
pub fn capture_of(
    py: Python<'_>,
    v: &Bound<'_, PyAny>,
    i: &Bound<'_, PyAny>,
    fs: f64,
    t0: f64,
    name: &str,
) -> PyResult<Capture> {
    let dt_s = 1.0 / in_range("fs", fs, StatedRange::AboveZero)?;
    let t0 = in_range("t0", t0, StatedRange::TimeS)?;
    let (v_v, i_a) = (singles(v, "v")?, singles(i, "i")?);
    if v_v.len() != i_a.len() {
        let text = format!(
            "v has {} samples, i has {}: both must be as long",
            v_v.len(),
            i_a.len()
        );
        return Err(PyValueError::new_err(text));
    }
    if v_v.is_empty() {
        return Err(value("v and i are empty"));
    }
    let facts = ihd_signal::Capture {
        name: name.to_owned(),
        time: TimeBase::Even { t0_s: t0, dt_s },
        v_v,
        i_a,
        ..ihd_signal::Capture::default()
    };
    Ok(Capture::new(py, facts))
}

/// Samples of an array of doubles or singles, in one pass, whatever its strides.
fn singles(x: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<f32>> {
    if let Ok(x) = x.cast::<PyArrayDyn<f64>>() {
        return Ok(one_axis(x, name)?
            .as_array()
            .iter()
            .map(|x| *x as f32)
            .collect());
    }
    let Ok(x) = x.cast::<PyArrayDyn<f32>>() else {
        let text = format!("{name}: must be an array of float64 or float32");
        return Err(PyTypeError::new_err(text));
    };
    Ok(one_axis(x, name)?.as_array().iter().copied().collect())
}

fn one_axis<'py, T: Element>(
    x: &Bound<'py, PyArrayDyn<T>>,
    name: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let x = x.try_readonly().map_err(value)?;
    match x.as_array().ndim() {
        1 => Ok(x),
        axes => Err(value(format!("{name}: has {axes} axes, must have one"))),
    }
}
