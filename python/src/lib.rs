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
mod simulate;
mod store;

use pyo3::prelude::*;

/// Functions and classes behind the package `ihd`; use those of `ihd`.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use crate::capture::state::{restored, state_of};
    #[pymodule_export]
    use crate::capture::{Capture, capture_of, read};
    #[pymodule_export]
    use crate::errors::{CaptureError, IdentifyError, StoreError};
    #[pymodule_export]
    use crate::identify::{Outcome, identify, methods};
    #[pymodule_export]
    use crate::simulate::{presets, simulate};
    #[pymodule_export]
    use crate::store::Store;
}
