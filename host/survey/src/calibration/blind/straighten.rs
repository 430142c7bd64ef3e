//! Correction of a current sensor that saturates: i = s·artanh(i′/s), with the s that leaves the plateaus no cubed current.
//!
//! One parameter is all that plateaus determine. Other curves with the same cubic term differ by the square of the bend, which goes
//! into the deviations.

use ihd_signal::Capture;

use super::estimate::estimate;
use super::self_calibration::SelfCalibration;
use crate::Survey;

/// Saturation of the current's sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturation {
    /// Current in ampere at which the sensor saturates.
    pub at_a: f64,
    /// Relative loss of gain at the largest current.
    pub bend: f64,
    /// Relative loss of gain above which the sensor counts as saturated.
    pub limit: f64,
    /// Relative standard deviation that the correction leaves.
    pub left: f64,
}

/// Least saturation current over the largest sample: beyond, noise decides the corrected value.
const MIN_OVER_LARGEST: f64 = 1.1;

/// Most rounds of the search.
const MAX_ROUNDS: usize = 5;

/// Remaining bend that ends the search, and standard deviations of it.
const MAX_BEND: f64 = 5e-4;
const MAX_BEND_SIGMAS: f64 = 1.0;

/// Curves of sensors that plateaus cannot tell apart differ by this share of the squared bend.
const CURVES: f64 = 0.5;

/// Corrects the current of a capture; `None` if no saturation explains what the plateaus show.
pub(super) fn straighten(
    capture: &Capture,
    survey: &Survey,
    bent: &SelfCalibration,
) -> Option<(Capture, SelfCalibration, Saturation)> {
    // A lost gain g = (i/s)²/4 of the fundamental follows from tanh's cubic term.
    let curvature =
        |sensors: &SelfCalibration| 4.0 * sensors.tests.bend.value / (sensors.i_a * sensors.i_a);
    let mut inverse_square = curvature(bent);
    let mut found = None;
    for _ in 0..MAX_ROUNDS {
        if inverse_square <= 0.0 {
            return None;
        }
        let at_a = inverse_square.sqrt().recip();
        let mut straight = capture.clone();
        straightened(&mut straight, at_a)?;
        let sensors = estimate(&straight, survey, bent.known_capacitance_f).ok()?;
        let left = sensors.tests.bend;
        inverse_square += curvature(&sensors);
        let done = left.value.abs() < MAX_BEND.max(MAX_BEND_SIGMAS * left.sigma);
        found = Some((straight, sensors, at_a));
        if done {
            break;
        }
    }
    let (straight, sensors, at_a) = found.filter(|f| f.1.is_sound())?;
    let bend = bent.tests.bend.value;
    let saturation = Saturation {
        at_a,
        bend,
        limit: bent.max_gain_change(),
        left: sensors.tests.bend.sigma.hypot(CURVES * bend * bend),
    };
    Some((straight, sensors, saturation))
}

/// Straightens the current's samples; `None` if one of them is at the saturation.
fn straightened(capture: &mut Capture, at_a: f64) -> Option<()> {
    for x in &mut capture.i_a {
        let share = f64::from(*x) / at_a;
        if share.abs() * MIN_OVER_LARGEST > 1.0 {
            return None;
        }
        // NaN stays NaN.
        *x = (at_a * libm::atanh(share)) as f32;
    }
    Some(())
}
