//! What was found in a window, as it travels: by a thread of this daemon, or by a worker of the fleet (docs/fleet.md).

use std::time::Instant;

use ihd_link::Window;
use ihd_map::Curve as MapCurve;
use ihd_store::Curve;
use ihd_survey::calibration::blind::Correction;
use ihd_train::NetworkConfig;
use ihd_train::learning::{Alone, Evidence, study};
use serde::{Deserialize, Serialize};

use super::outcome::{Course, Numbers};
use crate::model::{FitRemark, FitStep};

/// Most text that is taken from elsewhere, in bytes: a verdict, a remark.
const MOST_TEXT: usize = 2_000;

/// Most remarks and steps that are taken from elsewhere.
const MOST_ENTRIES: usize = 1_024;

/// Longest time in seconds that an honest worker is busy with a window; the slowest network there is takes minutes.
const LONGEST_BUSY_S: f64 = 3_600.0;

/// What was found in a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Studied {
    /// The window's number since its device's boot.
    pub seq: u32,
    /// Half-cycle since the device's boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Mean power of the half-cycle in watt, where it is known.
    pub power_w: Option<f64>,
    /// In a few numbers.
    pub numbers: Numbers,
    /// Why the gate refused it; none where it passed.
    pub refused: Option<String>,
    /// Steps of the optimiser, thinned.
    pub steps: Vec<FitStep>,
    /// What was remarked on it.
    pub remarks: Vec<FitRemark>,
    /// R(t) and L(t), thinned.
    pub trajectory: Option<Curve>,
    /// R and L over current, for the map; none where it was refused, or another one has learned from it.
    pub curve: Option<MapCurve>,
    /// What it says of its device's sensors.
    pub evidence: Evidence,
    /// Seconds that it took.
    pub busy_s: f64,
}

/// Why something from elsewhere is not taken.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum NotTaken {
    /// The curve is no load's.
    #[error("its R and L over current are no load's")]
    Curve,
    /// The lists of R(t) and L(t) are not equally long, or too long.
    #[error("its lists of R(t) and L(t) do not belong together")]
    Trajectory,
    /// The time that it took is none.
    #[error("it took {0} s, which is not 0 to {LONGEST_BUSY_S} s")]
    Busy(f64),
    /// Text or lists beyond all measure.
    #[error("its {0} are longer than any honest ones")]
    TooLong(&'static str),
}

/// Identifies a window from nothing but it and the skew in seconds that is to be taken out of its current: the same on every machine.
pub fn study_alone(window: &Window, skew_s: Option<f64>, network: NetworkConfig) -> Studied {
    let began = Instant::now();
    let correction = skew_s.map(|skew_s| Correction {
        skew_s,
        ..Correction::default()
    });
    let Alone {
        identified,
        findings,
        verdict,
        evidence,
    } = study(window, correction.as_ref(), network, &mut |_| ());
    let identified = identified.as_deref();
    let course = Course::of(identified, &findings, None);
    let (curve, refused) = match verdict {
        Ok(curve) => (Some(curve), None),
        Err(why) => (None, Some(why)),
    };
    let of = (window.seq, window.half_cycle);
    let numbers = identified.map_or(Numbers::NONE, Numbers::of);
    Studied {
        refused,
        steps: course.steps,
        remarks: course.remarks,
        trajectory: course.curve,
        curve,
        evidence,
        busy_s: began.elapsed().as_secs_f64(),
        ..Studied::of_numbers(of, window.f_sw_hz, numbers)
    }
}

impl Studied {
    /// A window's numbers alone; `of` is its own number and its half-cycle, since its device's boot.
    pub fn of_numbers(of: (u32, u32), f_sw_hz: u32, numbers: Numbers) -> Self {
        let (seq, half_cycle) = of;
        Self {
            seq,
            half_cycle,
            f_sw_hz,
            power_w: None,
            numbers,
            refused: None,
            steps: Vec::new(),
            remarks: Vec::new(),
            trajectory: None,
            curve: None,
            evidence: Evidence::default(),
            busy_s: 0.0,
        }
    }

    /// Looks at what came from another machine, which may lie.
    ///
    /// # Errors
    /// [`NotTaken`].
    pub fn check(&self) -> Result<(), NotTaken> {
        if !(0.0..=LONGEST_BUSY_S).contains(&self.busy_s) {
            return Err(NotTaken::Busy(self.busy_s));
        }
        if self.curve.as_ref().is_some_and(|curve| !curve.is_sound()) {
            return Err(NotTaken::Curve);
        }
        if let Some(found) = &self.trajectory
            && !found.is_sound()
        {
            return Err(NotTaken::Trajectory);
        }
        let remarks = self.remarks.iter();
        let longest = remarks.map(|r| r.text.len().max(r.code.len()).max(r.severity.len()));
        let why = self.refused.as_ref().map_or(0, String::len);
        if longest.fold(why, usize::max) > MOST_TEXT {
            return Err(NotTaken::TooLong("words"));
        }
        if self.remarks.len().max(self.steps.len()) > MOST_ENTRIES {
            return Err(NotTaken::TooLong("lists"));
        }
        Ok(())
    }
}
