//! A daemon's store as columns. Each call opens the store's databases for reading and closes them: a daemon may write meanwhile.

use std::path::{Path, PathBuf};

use ihd_store::export;
use ihd_store::{JournalFilter, ResultFilter, Spread, StoreError as ReadError, StoreReader};
use ihd_store::{TelemetrySpan, WindowFilter};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::capture::Capture;
use crate::errors::StoreError;

/// Every row: a caller narrows the time instead.
const ALL: Option<u32> = Some(u32::MAX);

/// Store of a daemon, read-only.
#[pyclass(frozen, module = "ihd._native")]
pub struct Store {
    folder: PathBuf,
}

/// Columns of a table under construction.
struct Columns<'py, 'r, R> {
    dict: Bound<'py, PyDict>,
    rows: &'r [R],
}

impl<'py, 'r, R> Columns<'py, 'r, R> {
    fn new(py: Python<'py>, rows: &'r [R]) -> Self {
        let dict = PyDict::new(py);
        Self { dict, rows }
    }

    fn integers<T: Into<i64>>(self, name: &str, of: impl Fn(&'r R) -> T) -> PyResult<Self> {
        self.array(name, |row| of(row).into())
    }

    /// A number that is missing is NaN.
    fn numbers(self, name: &str, of: impl Fn(&'r R) -> Option<f64>) -> PyResult<Self> {
        self.array(name, |row| of(row).unwrap_or(f64::NAN))
    }

    fn array<T: numpy::Element>(self, name: &str, of: impl Fn(&'r R) -> T) -> PyResult<Self> {
        let values = PyArray1::from_vec(self.dict.py(), self.rows.iter().map(of).collect());
        self.dict.set_item(name, values)?;
        Ok(self)
    }

    fn texts(self, name: &str, of: impl Fn(&'r R) -> Option<&'r str>) -> PyResult<Self> {
        let texts: Vec<_> = self.rows.iter().map(of).collect();
        self.dict.set_item(name, texts)?;
        Ok(self)
    }

    /// Least, mean and largest as three columns.
    fn spread(
        self,
        [name, unit]: [&str; 2],
        scale: f64,
        of: impl Fn(&'r R) -> &'r Spread,
    ) -> PyResult<Self> {
        let mut parts = ["min", "mean", "max"].into_iter().enumerate();
        parts.try_fold(self, |columns, (k, part)| {
            let value = |row| of(row).min_mean_max().map(|all| all[k] * scale);
            columns.numbers(&format!("{name}_{part}_{unit}"), value)
        })
    }
}

fn failed(error: ReadError) -> PyErr {
    StoreError::new_err(error.to_string())
}

impl Store {
    /// Reads rows without the interpreter's lock.
    fn rows<R: Send>(
        &self,
        py: Python<'_>,
        read: impl Fn(&StoreReader) -> Result<R, ReadError> + Sync,
    ) -> PyResult<R> {
        let folder: &Path = &self.folder;
        py.detach(|| read(&StoreReader::open(folder)?))
            .map_err(failed)
    }
}

#[pymethods]
impl Store {
    /// Opens the store in a folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let store = Self { folder: path };
        store.rows(py, |_| Ok(()))?;
        Ok(store)
    }

    /// Names of its devices.
    #[getter]
    fn devices(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let rows = self.rows(py, StoreReader::devices)?;
        Ok(rows.into_iter().map(|row| row.name).collect())
    }

    /// Windows, without their samples.
    #[pyo3(signature = (device=None, since_ms=None))]
    fn windows<'py>(
        &self,
        py: Python<'py>,
        device: Option<String>,
        since_ms: Option<i64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let filter = WindowFilter {
            device,
            since_ms,
            ..WindowFilter::default()
        };
        let rows = self.rows(py, |reader| reader.windows(&filter))?;
        let columns = Columns::new(py, &rows)
            .integers("at", |row| row.at_ms)?
            .texts("device", |row| Some(&row.device))?
            .integers("boot", |row| row.boot)?
            .integers("seq", |row| row.seq)?
            .integers("half_cycle", |row| row.half_cycle)?
            .integers("f_sw_hz", |row| row.f_sw_hz)?
            .integers("pairs", |row| row.pairs)?
            .texts("not_kept", |row| row.not_kept.as_deref())?;
        Ok(columns.dict)
    }

    /// Results, oldest first.
    #[pyo3(signature = (device=None, since_ms=None))]
    fn results<'py>(
        &self,
        py: Python<'py>,
        device: Option<String>,
        since_ms: Option<i64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let filter = ResultFilter {
            device,
            since_ms,
            limit: ALL,
        };
        let mut rows = self.rows(py, |reader| reader.results(&filter))?;
        rows.reverse();
        let columns = Columns::new(py, &rows)
            .integers("at", |row| row.at_ms)?
            .texts("device", |row| Some(&row.device))?
            .integers("boot", |row| row.boot)?
            .integers("seq", |row| row.seq)?
            .integers("half_cycle", |row| row.half_cycle)?
            .integers("f_sw_hz", |row| row.f_sw_hz)?
            .numbers("i_crest_a", |row| Some(row.i_crest_a))?
            .numbers("power_w", |row| row.power_w)?
            .numbers("r_ohm", |row| Some(row.r_ohm))?
            .numbers("l_h", |row| Some(row.l_h))?
            .numbers("sigma_r_pct", |row| Some(row.sigma_r_pct))?
            .numbers("sigma_l_pct", |row| Some(row.sigma_l_pct))?
            .array("passed", |row| row.pass)?
            .texts("why", |row| Some(&row.why))?
            .array("changed_lookup", |row| row.changed_lookup)?;
        Ok(columns.dict)
    }

    /// Events and commands, oldest first.
    #[pyo3(signature = (device=None, since_ms=None))]
    fn events<'py>(
        &self,
        py: Python<'py>,
        device: Option<String>,
        since_ms: Option<i64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let filter = JournalFilter {
            device,
            since_ms,
            limit: ALL,
            ..JournalFilter::default()
        };
        let mut rows = self.rows(py, |reader| reader.journal(&filter))?;
        rows.reverse();
        let columns = Columns::new(py, &rows)
            .integers("at", |row| row.at_ms)?
            .texts("device", |row| row.device.as_deref())?
            .texts("kind", |row| Some(&row.kind))?
            .texts("holder", |row| Some(&row.holder))?
            .texts("text", |row| Some(&row.text))?
            .texts("outcome", |row| Some(&row.outcome))?;
        Ok(columns.dict)
    }

    /// Telemetry of a device in rows of a second, or of a minute, from one time until before another, in seconds since 1970.
    #[pyo3(signature = (device, from_s, to_s, minutes))]
    fn telemetry<'py>(
        &self,
        py: Python<'py>,
        device: String,
        from_s: i64,
        to_s: i64,
        minutes: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let rows = self.rows(py, |reader| {
            let mut rows = Vec::new();
            let each = &mut |span: TelemetrySpan| rows.push(span);
            reader.telemetry(&device, (from_s, to_s), minutes, each)?;
            Ok(rows)
        })?;
        let columns = Columns::new(py, &rows)
            .integers("at", |row| row.at_s.saturating_mul(1000))?
            .integers("asked_w", |row| row.asked_w)?
            .integers("fault", |row| row.fault)?
            .spread(["power", "w"], 1e-3, |row| &row.power_mw)?
            .spread(["i_crest", "a"], 1e-3, |row| &row.i_crest_ma)?
            .spread(["r", "ohm"], 1e-6, |row| &row.r_uohm)?
            .spread(["l", "h"], 1e-12, |row| &row.l_ph)?
            .spread(["f_sw", "hz"], 1.0, |row| &row.f_sw_hz)?;
        Ok(columns.dict)
    }

    /// Samples of a window; `None` if there is none, or its samples are not stored.
    fn capture(
        &self,
        py: Python<'_>,
        device: String,
        boot: u32,
        seq: u32,
    ) -> PyResult<Option<Capture>> {
        let found = self.rows(py, |reader| reader.whole_window(&device, boot, seq))?;
        let capture = found.map(|(row, window, _)| export::capture(&row, &window));
        Ok(capture.map(|capture| Capture::new(py, capture)))
    }
}
