//! Extension module of the Python package `ihd`: a thin layer over the rooms that `ihd identify`, `simulate` and `store` use.
//!
//! ```text
//!  file, arrays, simulation, store ─► Capture ─► identify ─► Outcome: arrays of t, R, L, σ; verdict
//! ```
//!
//! Samples leave the Python objects under the interpreter's lock; computation runs without it.

mod capture;
mod errors;
mod identify;
mod interrupt;
mod simulate;
mod store;

use pyo3::prelude::*;

/// Functions and classes behind the package `ihd`; use those of `ihd`.
#[pymodule(name = "_native")]
mod native {
    use numpy::{PyArray1, PyArrayMethods};
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::capture::state::{restored, state_of};
    #[pymodule_export]
    use crate::capture::{Capture, capture_of, read};
    #[pymodule_export]
    use crate::errors::{CaptureError, IdentifyError, StoreError};
    #[pymodule_export]
    use crate::identify::{Outcome, identify, methods, overall_verdict};
    #[pymodule_export]
    use crate::simulate::{presets, simulate};
    #[pymodule_export]
    use crate::store::Store;

    /// Loads numpy's interface. In the first call, with ^C pending, it would panic.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.py().import("numpy")?;
        let array = PyArray1::<f64>::zeros(module.py(), [0], false);
        array.try_readonly().map(drop).map_err(crate::errors::value)
    }
}
