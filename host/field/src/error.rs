//! Errors of a field model's inputs.

use thiserror::Error;

/// Refused input of the field model; the message names the field and what is allowed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FieldError {
    /// A number is NaN, infinite or outside its range.
    #[error("{field} is {value}: must be {allowed}")]
    OutOfRange {
        /// Name of the input, with its unit.
        field: &'static str,
        /// Value that was given.
        value: f64,
        /// Allowed range as text.
        allowed: &'static str,
    },
    /// Two lengths contradict each other.
    #[error(
        "impossible geometry: {smaller} ({smaller_m} m) must be less than {larger} ({larger_m} m)"
    )]
    Order {
        /// Name of the length that must be smaller.
        smaller: &'static str,
        /// Its value in metre.
        smaller_m: f64,
        /// Name of the length that must be larger.
        larger: &'static str,
        /// Its value in metre.
        larger_m: f64,
    },
    /// The gap's linear system could not be factored.
    #[error("the gap's field equations are singular ({nodes} nodes): check the geometry")]
    Singular {
        /// Unknowns of the system.
        nodes: usize,
    },
    /// A law whose B falls with H has no stable field in time.
    #[error("the paper's literal µ_r(H) has no time domain: B falls beyond H = α")]
    NoTimeDomain,
    /// A foil's or its base's law is another than Fröhlich's.
    #[error("in the time domain a foil and its base follow Fröhlich's law or are linear")]
    FoilLaw,
    /// The harmonic iteration did not converge.
    #[error(
        "harmonic balance at {f_hz} Hz, {i_a} A did not settle: relative change {change:e} after {iterations} iterations"
    )]
    NotSettled {
        /// Frequency in hertz.
        f_hz: f64,
        /// Current amplitude in ampere.
        i_a: f64,
        /// Relative change in the last iteration.
        change: f64,
        /// Iterations done.
        iterations: usize,
    },
}

/// Returns `Ok` for a finite number inside `min..=max`, else an error.
pub fn in_range(
    field: &'static str,
    value: f64,
    min: f64,
    max: f64,
    allowed: &'static str,
) -> Result<(), FieldError> {
    if value.is_finite() && (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(FieldError::OutOfRange {
            field,
            value,
            allowed,
        })
    }
}
