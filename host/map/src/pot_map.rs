//! Map of one pot: fused curves of its windows, and a prediction for every cell of a lookup.

use std::sync::Arc;

use ihd_shared::lookup::grid::{
    CURRENTS, FREQUENCIES, ONE, current_a, frequency_coordinate, frequency_hz, split,
};
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::curve::CurrentCurve;
use crate::fit::Datum;
use crate::hypotheses::{Comparison, Hypotheses, LibraryHypothesisState};
use crate::library::Library;
use crate::misfit::{current_knots, current_of_knots};
use crate::posterior::{Posterior, RlPrediction};
use crate::pot_fit::PotFit;
use crate::surface_table::lagrange;

/// Relative difference below which two switching frequencies share a curve; R and L are converted by the pot's own law.
const MAX_FREQUENCY_DIFFERENCE: f64 = 5e-3;

/// Most curves of a map: more than the eight rows of a lookup can resolve.
pub const MAX_CURVES: usize = 10;

/// Mean square in expected variances above which a window belongs to another pot: chance gives 2 once in a million for
/// the forty numbers of a window.
const ANOTHER: f64 = 3.0;

/// Root mean square of the relative difference of R or L below which a pot is never another one: power control does not
/// notice it.
const NEVER_ANOTHER: f64 = 3e-3;

/// Mean square above which a window causes another fit.
const MIN_MEAN_SQUARE: f64 = 1.6;

/// Least current in ampere of compared points: below, R and L are uncertain.
const COUNTS_FROM_A: f64 = 3.0;

/// Confidence from which a cell counts as observed: a curve within three quarters of a step.
const MIN_CONFIDENCE: f64 = 0.5;

/// Weight of a curve at which confidence is one half.
const HALF_CONFIDENCE_WEIGHT: f64 = 0.25;

/// Comparison of a window's curve with the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CurveMatch {
    /// Not used: no frequency of a hob, or no load at it.
    Nothing,
    /// First curve of a pot.
    First,
    /// Fused with the others, but not compared: no current of [`COUNTS_FROM_A`] or more.
    NotCompared,
    /// Same pot as before.
    Same {
        /// Mean square in expected variances; about 1 if all deviations are right.
        chi2: f64,
    },
    /// Another pot, or the same one moved; all other curves were removed.
    Another {
        /// Mean square in variances expected of the known pot.
        chi2: f64,
        /// Root mean square of the relative difference of R from the expectation.
        r: f64,
        /// Root mean square of the relative difference of L from the expectation.
        l: f64,
    },
}

/// One cell of a lookup.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapCell {
    /// Predicted R and L, with relative deviations.
    pub value: RlPrediction,
    /// 0 (never observed) to 1.
    pub confidence: f64,
    /// Seconds since the cell was observed last; `None` if never.
    pub age_s: Option<f64>,
}

impl MapCell {
    /// Returns `true` if the cell rests on observations and not on the pot's physics alone.
    pub fn is_observed(&self) -> bool {
        self.confidence >= MIN_CONFIDENCE
    }
}

/// All cells of a lookup, `[frequency][current]`.
pub type Cells = [[MapCell; CURRENTS]; FREQUENCIES];

/// Map of the pot that stands on the coil now.
#[derive(Clone, Debug, Default)]
pub struct PotMap {
    curves: Vec<CurrentCurve>,
    learned: Option<LastFit>,
    library: Option<Arc<Library>>,
}

/// Last fit, its curves, and its time.
#[derive(Clone, Debug)]
struct LastFit {
    hypotheses: Hypotheses,
    curves: Vec<CurrentCurve>,
    at_s: f64,
}

/// Stored form of a map; a restored map gives the same predictions, bit for bit.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PotMapState {
    curves: Vec<CurrentCurve>,
    learned: Option<LastFitState>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct LastFitState {
    #[serde(rename = "ended")]
    fit: PotFit,
    /// Pots of the library that it may be; builds before the library ignore them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    recognised: Vec<LibraryHypothesisState>,
    curves: Vec<CurrentCurve>,
    at_s: f64,
}

impl PotMap {
    /// Returns the stored form.
    pub fn state(&self) -> PotMapState {
        PotMapState {
            curves: self.curves.clone(),
            learned: self.learned.as_ref().map(|l| LastFitState {
                fit: *l.hypotheses.any().fit(),
                recognised: l.hypotheses.state(),
                curves: l.curves.clone(),
                at_s: l.at_s,
            }),
        }
    }

    /// Restores a map; `None` if no windows can have produced the numbers.
    pub fn from_state(state: PotMapState) -> Option<Self> {
        let sound = |curves: &[CurrentCurve]| {
            curves.len() <= MAX_CURVES && curves.iter().all(CurrentCurve::is_sound)
        };
        if !sound(&state.curves) {
            return None;
        }
        let learned = match state.learned {
            None => None,
            Some(l) if sound(&l.curves) && l.at_s.is_finite() => Some(LastFit {
                hypotheses: Hypotheses::from_state(l.fit, l.recognised, data(&l.curves, l.at_s))?,
                curves: l.curves,
                at_s: l.at_s,
            }),
            Some(_) => return None,
        };
        Some(Self {
            curves: state.curves,
            learned,
            library: None,
        })
    }

    /// Returns the map with a library, which is searched for a new pot, and again at each frequency seen for the first time.
    /// An empty library changes nothing. The library is not part of the stored form.
    #[must_use]
    pub fn with_library(mut self, library: Arc<Library>) -> Self {
        self.library = Some(library);
        self
    }

    /// Library that is searched; `None` if there is none.
    pub fn library(&self) -> Option<&Library> {
        self.library.as_deref()
    }

    /// Returns an empty map with the same library.
    #[must_use]
    pub fn forgotten(&self) -> Self {
        Self {
            library: self.library.clone(),
            ..Self::default()
        }
    }

    /// Names of the library's pots that it may be, with their shares; the rest to 1 is any other pot.
    pub fn recognised(&self) -> impl Iterator<Item = (&str, f64)> {
        self.learned.iter().flat_map(|l| l.hypotheses.recognised())
    }

    /// Result of this hob's own windows alone; `None` before the first window.
    pub(crate) fn own_posterior(&self) -> Option<&Posterior> {
        self.learned.as_ref().map(|l| l.hypotheses.any())
    }

    /// Curves, one per switching frequency.
    pub fn curves(&self) -> &[CurrentCurve] {
        &self.curves
    }

    /// Adds a window's curve. Fits at once for another pot, a new frequency, twice the windows, or a difference beyond chance;
    /// otherwise the next [`Self::refresh`] fits.
    pub fn observe(&mut self, curve: CurrentCurve) -> CurveMatch {
        if !curve.is_sound() || curve.means().next().is_none() {
            return CurveMatch::Nothing;
        }
        let (comparison, differs) = self.compare(&curve);
        let another = matches!(comparison, CurveMatch::Another { .. });
        if another {
            self.curves.clear();
        }
        let now_s = curve.t_s;
        let windows = self.fuse(curve);
        if differs || windows.is_power_of_two() {
            self.fit(now_s, another);
        }
        comparison
    }

    /// Compares a window with the prediction; the second value is `true` if a new fit is worthwhile.
    fn compare(&self, curve: &CurrentCurve) -> (CurveMatch, bool) {
        let Some(learned) = &self.learned else {
            return (CurveMatch::First, true);
        };
        let means: Vec<_> = curve.means().filter(|m| m.i_a >= COUNTS_FROM_A).collect();
        let compared = match means.is_empty() {
            true => None,
            false => learned
                .hypotheses
                .compare(curve, &means, curve.t_s - learned.at_s),
        };
        let Some(Comparison {
            chi2,
            off: [r, l],
            most_chi2,
        }) = compared
        else {
            return (CurveMatch::NotCompared, false);
        };
        if chi2 > ANOTHER && r.max(l) > NEVER_ANOTHER {
            (CurveMatch::Another { chi2, r, l }, true)
        } else {
            (
                CurveMatch::Same { chi2 },
                most_chi2.is_nan() || most_chi2 >= MIN_MEAN_SQUARE,
            )
        }
    }

    /// Fuses a curve with that of its frequency, and returns the number of windows in it.
    fn fuse(&mut self, curve: CurrentCurve) -> u32 {
        let away = |c: &CurrentCurve| (c.f_sw_hz / curve.f_sw_hz - 1.0).abs();
        let ratio_to = |f_hz| {
            frequency_ratio(
                self.learned.as_ref().map(|l| &l.hypotheses),
                curve.f_sw_hz,
                f_hz,
            )
        };
        let nearest = (0..self.curves.len())
            .filter(|k| away(&self.curves[*k]) < MAX_FREQUENCY_DIFFERENCE)
            .min_by(|a, b| away(&self.curves[*a]).total_cmp(&away(&self.curves[*b])));
        if let Some(k) = nearest {
            let ratio = ratio_to(self.curves[k].f_sw_hz);
            self.curves[k].fuse(&curve, ratio);
            return self.curves[k].windows;
        }
        if self.curves.len() == MAX_CURVES {
            let oldest = |a: &usize, b: &usize| self.curves[*a].t_s.total_cmp(&self.curves[*b].t_s);
            if let Some(oldest) = (0..self.curves.len()).min_by(oldest) {
                self.curves.remove(oldest);
            }
        }
        self.curves.push(curve);
        1
    }

    /// Time of the newest window in seconds of the device; negative infinity if there is none.
    pub fn newest_s(&self) -> f64 {
        let times = self.curves.iter().map(|c| c.t_s);
        times.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Shifts all times so that none lies after `now_s`: a device that was reset counts its time anew.
    pub fn rebase(&mut self, now_s: f64) {
        let newest_s = self.newest_s();
        if newest_s <= now_s {
            return;
        }
        let shift_s = now_s - newest_s;
        self.curves.iter_mut().for_each(|c| c.t_s += shift_s);
        if let Some(learned) = &mut self.learned {
            learned.curves.iter_mut().for_each(|c| c.t_s += shift_s);
            learned.at_s += shift_s;
        }
    }

    /// Fits all curves as of a time in seconds of the device.
    pub fn refresh(&mut self, now_s: f64) {
        self.fit(now_s, false);
    }

    fn fit(&mut self, now_s: f64, another: bool) {
        let before = self.learned.as_ref();
        // A new frequency can separate pots that look alike at one frequency.
        let again = another || before.is_none_or(|l| l.curves.len() != self.curves.len());
        let library = self.library.as_deref();
        let all = data(&self.curves, now_s);
        let known = Hypotheses::fit(all, library, before.map(|l| &l.hypotheses), again);
        self.learned = known.map(|hypotheses| LastFit {
            hypotheses,
            curves: self.curves.clone(),
            at_s: now_s,
        });
    }

    /// Fitted physics; `None` before the first window.
    pub fn model(&self) -> Option<PotModel> {
        self.learned.as_ref().map(|l| l.hypotheses.model())
    }

    /// Predicts R and L along a half-cycle: at a switching frequency in hertz and many currents in ampere, interpolated
    /// between a few. Empty before the first window.
    pub fn along(&self, f_hz: f64, currents_a: &[f64], now_s: f64) -> Vec<RlPrediction> {
        /// Points per knot of the lookup's current axis: a cubic through them is within 1e-5 of R and L.
        const PER_KNOT: f64 = 1.5;
        let most_a = currents_a.iter().copied().fold(0.0, f64::max);
        let count = ((current_knots(most_a) * PER_KNOT).ceil() as usize + 1).max(4);
        let nodes_a: Vec<f64> = (0..count)
            .map(|k| current_of_knots(k as f64 / PER_KNOT))
            .collect();
        let nodes = self.at(f_hz, &nodes_a, now_s);
        if nodes.is_empty() {
            return nodes;
        }
        let between = |i_a: &f64| {
            let x = current_knots(*i_a) * PER_KNOT;
            let first = (x as usize).saturating_sub(1).min(count - 4);
            let weights = lagrange([0.0, 1.0, 2.0, 3.0], x - first as f64);
            let mix = |of: fn(&RlPrediction) -> f64| {
                (0..4).map(|k| weights[k] * of(&nodes[first + k])).sum()
            };
            RlPrediction {
                r_ohm: mix(|p| p.r_ohm),
                l_h: mix(|p| p.l_h),
                r_sigma: f64::max(mix(|p| p.r_sigma), 0.0),
                l_sigma: f64::max(mix(|p| p.l_sigma), 0.0),
            }
        };
        currents_a.iter().map(between).collect()
    }

    /// Predicts R and L at a switching frequency in hertz and currents in ampere. Empty before the first window.
    pub fn at(&self, f_hz: f64, currents_a: &[f64], now_s: f64) -> Vec<RlPrediction> {
        let places: Vec<_> = currents_a.iter().map(|i| (f_hz, *i)).collect();
        let of = |l: &LastFit| l.hypotheses.at(&places, now_s - l.at_s);
        self.learned.as_ref().map(of).unwrap_or_default()
    }

    /// Predicts every cell; `None` before the first window.
    pub fn cells(&self, now_s: f64) -> Option<Cells> {
        let learned = self.learned.as_ref()?;
        let places: Vec<_> = (0..FREQUENCIES)
            .flat_map(|f| (0..CURRENTS).map(move |i| (frequency_hz(f), current_a(i))))
            .collect();
        let values = learned.hypotheses.at(&places, now_s - learned.at_s);
        let (mass, last_s) = self.mass();
        Some(std::array::from_fn(|f| {
            std::array::from_fn(|i| MapCell {
                value: values[f * CURRENTS + i],
                confidence: mass[f][i] / (mass[f][i] + HALF_CONFIDENCE_WEIGHT),
                age_s: last_s[f][i].map(|t_s| (now_s - t_s).max(0.0)),
            })
        }))
    }

    /// Number of curves through each cell, and the time of the last one: a curve counts for the cells from which a lookup
    /// would interpolate it.
    fn mass(
        &self,
    ) -> (
        [[f64; CURRENTS]; FREQUENCIES],
        [[Option<f64>; CURRENTS]; FREQUENCIES],
    ) {
        let mut mass = [[0.0; CURRENTS]; FREQUENCIES];
        let mut last_s = [[None; CURRENTS]; FREQUENCIES];
        for curve in &self.curves {
            let (row, above) = split(
                frequency_coordinate(curve.f_sw_hz.round() as u32),
                FREQUENCIES,
            );
            let above = above as f64 / ONE as f64;
            let reaches = curve
                .means()
                .map(|m| current_knots(m.i_a))
                .fold(-1.0, f64::max);
            for i in 0..CURRENTS {
                let within = (reaches + 1.0 - i as f64).clamp(0.0, 1.0);
                for (f, share) in [(row, 1.0 - above), (row + 1, above)] {
                    let weight = share * within;
                    mass[f][i] += weight;
                    if weight / (weight + HALF_CONFIDENCE_WEIGHT) >= MIN_CONFIDENCE {
                        let last: &mut Option<f64> = &mut last_s[f][i];
                        *last = Some(last.map_or(curve.t_s, |t_s| t_s.max(curve.t_s)));
                    }
                }
            }
        }
        (mass, last_s)
    }
}

/// Means of all curves, with their ages at a time in seconds of the device.
fn data(curves: &[CurrentCurve], now_s: f64) -> Vec<Datum> {
    let of = |curve: &CurrentCurve| {
        let (f_hz, age_s) = (curve.f_sw_hz, (now_s - curve.t_s).max(0.0));
        let datum = |m: crate::curve::Mean| Datum {
            f_hz,
            i_a: m.i_a,
            ln: m.ln,
            variance: m.variance,
            level: m.level,
            common: m.common,
            age_s,
        };
        curve.means().map(datum).collect::<Vec<_>>()
    };
    curves.iter().flat_map(of).collect()
}

/// Ratio of R and of L between two close frequencies, by the pot's law at a medium current.
fn frequency_ratio(known: Option<&Hypotheses>, from_hz: f64, to_hz: f64) -> [f64; 2] {
    const I_A: f64 = 15.0;
    let Some(known) = known else {
        // R follows the square root of f by the skin effect.
        return [(to_hz / from_hz).sqrt(), 1.0];
    };
    let model = known.model();
    let (from, to) = (model.impedance(from_hz, I_A), model.impedance(to_hz, I_A));
    [to.r_ohm / from.r_ohm, to.l_h / from.l_h]
}
