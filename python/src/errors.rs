//! Exceptions of the package. Their texts are those of the program: what was wrong, where, and what to do.

use ihd_survey::StatedRange;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

create_exception!(
    ihd,
    CaptureError,
    PyException,
    "A file is no capture, or is damaged; or a channel has to be named."
);
create_exception!(
    ihd,
    IdentifyError,
    PyException,
    "A capture holds nothing that can be identified, or the method failed on all of it."
);
create_exception!(
    ihd,
    StoreError,
    PyException,
    "A store cannot be opened or read."
);

/// Converts an error to a `ValueError` with its text.
pub fn value(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Returns the option `name` if it lies within its range.
///
/// # Errors
/// A `ValueError` with name, number and range.
pub fn in_range(name: &str, x: f64, range: StatedRange) -> PyResult<f64> {
    range
        .check(x)
        .map_err(|error| value(format!("{name}={x}: {error}")))
}
