//! The map of one pot: what windows showed, fused, and what follows from it for every cell of a lookup.

use std::sync::Arc;

use ihd_shared::lookup::grid::{
    CURRENTS, FREQUENCIES, ONE, current_a, frequency_coordinate, frequency_hz, split,
};
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::curve::Curve;
use crate::ended::{Ended, UNDESCRIBED};
use crate::fit::Datum;
use crate::hypotheses::{Compared, Hypotheses, KeptRecognised};
use crate::knowledge::{Knowledge, Predicted};
use crate::library::Library;
use crate::misfit::{current_knots, current_of_knots};
use crate::surface_table::lagrange;

/// Relative difference below which two switching frequencies are one: R and L are carried over by the pot's own law.
const SAME_FREQUENCY: f64 = 5e-3;

/// Curves that are kept: more than eight rows of a lookup can tell apart.
pub const MOST_CURVES: usize = 10;

/// Squares a number, in means of what is expected, from which a window is another pot's: chance makes 2 once in a million
/// for the forty numbers of a window.
const ANOTHER: f64 = 3.0;

/// Relative difference of R or L, in the mean of the squares, below which a pot is never another one: power control does
/// not notice it.
const NEVER_ANOTHER: f64 = 3e-3;

/// Squares a number from which a window is worth another fit.
const WORTH_FITTING: f64 = 1.6;

/// Currents in ampere from which a difference counts: below, little is known of R and L.
const COUNTS_FROM_A: f64 = 3.0;

/// Confidence from which a cell counts as observed: a curve within three quarters of a step.
const OBSERVED_FROM: f64 = 0.5;

/// Weight of a curve at which confidence is one half.
const HALF_CONFIDENT: f64 = 0.25;

/// What became of a window's curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seen {
    /// Nothing: no frequency of a hob, or no load at it.
    Nothing,
    /// The first one of a pot.
    First,
    /// It is the pot that is known; squares a number of what was expected.
    Same {
        /// About 1 where all deviations are honest.
        chi2: f64,
    },
    /// It is another pot, or the same one moved: everything else was forgotten.
    Another {
        /// Squares a number of what was expected of the known pot.
        chi2: f64,
        /// How far R was from what was expected, relative, in the mean.
        r: f64,
        /// How far L was.
        l: f64,
    },
}

/// One cell of a lookup.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// R and L, with relative deviations.
    pub value: Predicted,
    /// 0, never observed, to 1.
    pub confidence: f64,
    /// Seconds since it was observed last; `None` where it never was.
    pub age_s: Option<f64>,
}

impl Cell {
    /// Whether it rests on observations, not on the pot's physics alone.
    pub fn is_observed(&self) -> bool {
        self.confidence >= OBSERVED_FROM
    }
}

/// All cells, `[frequency][current]`.
pub type Cells = [[Cell; CURRENTS]; FREQUENCIES];

/// What is known of the pot that stands on the coil now.
#[derive(Clone, Debug, Default)]
pub struct PotMap {
    curves: Vec<Curve>,
    learned: Option<Learned>,
    library: Option<Arc<Library>>,
}

/// What was fitted, from what, and when.
#[derive(Clone, Debug)]
struct Learned {
    known: Hypotheses,
    curves: Vec<Curve>,
    at_s: f64,
}

/// What of a map is kept over a restart: all that follows from it is the same, bit for bit.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Kept {
    curves: Vec<Curve>,
    learned: Option<KeptLearned>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct KeptLearned {
    ended: Ended,
    /// Pots of the library that it may be; a build before the library reads past them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    recognised: Vec<KeptRecognised>,
    curves: Vec<Curve>,
    at_s: f64,
}

impl PotMap {
    /// What is to be kept.
    pub fn kept(&self) -> Kept {
        Kept {
            curves: self.curves.clone(),
            learned: self.learned.as_ref().map(|l| KeptLearned {
                ended: *l.known.any().ended(),
                recognised: l.known.kept(),
                curves: l.curves.clone(),
                at_s: l.at_s,
            }),
        }
    }

    /// From what was kept; `None` where nothing could have taught it.
    pub fn from_kept(kept: Kept) -> Option<Self> {
        let sound =
            |curves: &[Curve]| curves.len() <= MOST_CURVES && curves.iter().all(Curve::is_sound);
        if !sound(&kept.curves) {
            return None;
        }
        let learned = match kept.learned {
            None => None,
            Some(l) if sound(&l.curves) && l.at_s.is_finite() => Some(Learned {
                known: Hypotheses::from_kept(l.ended, l.recognised, data(&l.curves, l.at_s))?,
                curves: l.curves,
                at_s: l.at_s,
            }),
            Some(_) => return None,
        };
        Some(Self {
            curves: kept.curves,
            learned,
            library: None,
        })
    }

    /// The same, which asks these pots when it sees one for the first time, and again at each frequency that it sees first.
    /// Without entries nothing changes. A library is no part of what is kept.
    #[must_use]
    pub fn with_library(mut self, library: Arc<Library>) -> Self {
        self.library = Some(library);
        self
    }

    /// The pots that it asks; `None` where nobody gave any.
    pub fn library(&self) -> Option<&Library> {
        self.library.as_deref()
    }

    /// One that has seen nothing, with the same library.
    #[must_use]
    pub fn forgotten(&self) -> Self {
        Self {
            library: self.library.clone(),
            ..Self::default()
        }
    }

    /// Pots of the library that it may be, by their names, with their shares; what is left to 1 is any other.
    pub fn recognised(&self) -> impl Iterator<Item = (&str, f64)> {
        self.learned.iter().flat_map(|l| l.known.recognised())
    }

    /// What this hob found by itself; `None` before a window came.
    pub(crate) fn found_alone(&self) -> Option<&Knowledge> {
        self.learned.as_ref().map(|l| l.known.any())
    }

    /// Curves, one a switching frequency.
    pub fn curves(&self) -> &[Curve] {
        &self.curves
    }

    /// Takes a window's curve in. What follows from it is fitted again where it is new: another pot, a frequency that was
    /// not seen, twice the windows, or more than chance off; else [`Self::refresh`] does.
    pub fn observe(&mut self, curve: Curve) -> Seen {
        if !curve.is_sound() || curve.means().next().is_none() {
            return Seen::Nothing;
        }
        let (seen, off) = self.compare(&curve);
        let another = matches!(seen, Seen::Another { .. });
        if another {
            self.curves.clear();
        }
        let now_s = curve.t_s;
        let windows = self.take(curve);
        if off || windows.is_power_of_two() {
            self.fit(now_s, another);
        }
        seen
    }

    /// What a window is beside what is known, and whether it is worth another fit.
    fn compare(&self, curve: &Curve) -> (Seen, bool) {
        let Some(learned) = &self.learned else {
            return (Seen::First, true);
        };
        let means: Vec<_> = curve.means().filter(|m| m.i_a >= COUNTS_FROM_A).collect();
        let compared = match means.is_empty() {
            true => None,
            false => learned
                .known
                .compare(curve, &means, curve.t_s - learned.at_s),
        };
        let Some(Compared {
            chi2,
            off: [r, l],
            most_chi2,
        }) = compared
        else {
            return (Seen::Same { chi2: 1.0 }, false);
        };
        if chi2 > ANOTHER && r.max(l) > NEVER_ANOTHER {
            (Seen::Another { chi2, r, l }, true)
        } else {
            (
                Seen::Same { chi2 },
                most_chi2.is_nan() || most_chi2 >= WORTH_FITTING,
            )
        }
    }

    /// Windows that the curve of this frequency now holds.
    fn take(&mut self, curve: Curve) -> u32 {
        let away = |c: &Curve| (c.f_sw_hz / curve.f_sw_hz - 1.0).abs();
        let ratio_to = |f_hz| carried(self.learned.as_ref().map(|l| &l.known), curve.f_sw_hz, f_hz);
        let nearest = (0..self.curves.len())
            .filter(|k| away(&self.curves[*k]) < SAME_FREQUENCY)
            .min_by(|a, b| away(&self.curves[*a]).total_cmp(&away(&self.curves[*b])));
        if let Some(k) = nearest {
            let ratio = ratio_to(self.curves[k].f_sw_hz);
            self.curves[k].fuse(&curve, ratio);
            return self.curves[k].windows;
        }
        if self.curves.len() == MOST_CURVES {
            let oldest = |a: &usize, b: &usize| self.curves[*a].t_s.total_cmp(&self.curves[*b].t_s);
            if let Some(oldest) = (0..self.curves.len()).min_by(oldest) {
                self.curves.remove(oldest);
            }
        }
        self.curves.push(curve);
        1
    }

    /// Time of the newest window in seconds of the device; negative infinity where nothing was seen.
    pub fn newest_s(&self) -> f64 {
        let times = self.curves.iter().map(|c| c.t_s);
        times.fold(f64::NEG_INFINITY, f64::max)
    }

    /// What was seen moves so that nothing of it lies after `now_s`: a device that was reset counts its time anew.
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

    /// Fits what has come until now, a time in seconds of the device.
    pub fn refresh(&mut self, now_s: f64) {
        self.fit(now_s, false);
    }

    fn fit(&mut self, now_s: f64, another: bool) {
        let before = self.learned.as_ref();
        // Another frequency tells pots apart that one shows alike.
        let again = another || before.is_none_or(|l| l.curves.len() != self.curves.len());
        let library = self.library.as_deref();
        let all = data(&self.curves, now_s);
        let known = Hypotheses::of(all, library, before.map(|l| &l.known), again);
        self.learned = known.map(|known| Learned {
            known,
            curves: self.curves.clone(),
            at_s: now_s,
        });
    }

    /// The pot's physics; `None` before a window came.
    pub fn model(&self) -> Option<PotModel> {
        self.learned.as_ref().map(|l| l.known.model())
    }

    /// Whether the physics describes the pot: one that stands far off centre, or that is made of parts, it may not.
    /// `None` before a window came.
    pub fn is_described(&self) -> Option<bool> {
        let misfit = self.learned.as_ref()?.known.misfit();
        Some(
            misfit
                .iter()
                .zip(UNDESCRIBED)
                .all(|(found, most)| *found < most),
        )
    }

    /// R and L at a switching frequency in hertz and many currents in ampere, interpolated between some: what is known of a
    /// half-cycle whose current is known. Empty before a window came.
    pub fn along(&self, f_hz: f64, currents_a: &[f64], now_s: f64) -> Vec<Predicted> {
        /// Points a knot of the lookup's current axis: a cubic through them is within 1e-5 of R and L.
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
            let mix = |of: fn(&Predicted) -> f64| {
                (0..4).map(|k| weights[k] * of(&nodes[first + k])).sum()
            };
            Predicted {
                r_ohm: mix(|p| p.r_ohm),
                l_h: mix(|p| p.l_h),
                r_sigma: f64::max(mix(|p| p.r_sigma), 0.0),
                l_sigma: f64::max(mix(|p| p.l_sigma), 0.0),
            }
        };
        currents_a.iter().map(between).collect()
    }

    /// R and L at a switching frequency in hertz and currents in ampere, with deviations; empty before a window came.
    pub fn at(&self, f_hz: f64, currents_a: &[f64], now_s: f64) -> Vec<Predicted> {
        let places: Vec<_> = currents_a.iter().map(|i| (f_hz, *i)).collect();
        let of = |l: &Learned| l.known.at(&places, now_s - l.at_s);
        self.learned.as_ref().map(of).unwrap_or_default()
    }

    /// Every cell; `None` before a window came.
    pub fn cells(&self, now_s: f64) -> Option<Cells> {
        let learned = self.learned.as_ref()?;
        let places: Vec<_> = (0..FREQUENCIES)
            .flat_map(|f| (0..CURRENTS).map(move |i| (frequency_hz(f), current_a(i))))
            .collect();
        let values = learned.known.at(&places, now_s - learned.at_s);
        let (mass, last_s) = self.mass();
        Some(std::array::from_fn(|f| {
            std::array::from_fn(|i| Cell {
                value: values[f * CURRENTS + i],
                confidence: mass[f][i] / (mass[f][i] + HALF_CONFIDENT),
                age_s: last_s[f][i].map(|t_s| (now_s - t_s).max(0.0)),
            })
        }))
    }

    /// How many curves went through each cell, and when the last one did: each counts for the cells that a lookup would
    /// interpolate it from.
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
                    if weight / (weight + HALF_CONFIDENT) >= OBSERVED_FROM {
                        let last: &mut Option<f64> = &mut last_s[f][i];
                        *last = Some(last.map_or(curve.t_s, |t_s| t_s.max(curve.t_s)));
                    }
                }
            }
        }
        (mass, last_s)
    }
}

/// What curves say at a time in seconds of the device.
fn data(curves: &[Curve], now_s: f64) -> Vec<Datum> {
    let of = |curve: &Curve| {
        let (f_hz, age_s) = (curve.f_sw_hz, now_s - curve.t_s);
        let datum = |m: crate::curve::Mean| Datum {
            f_hz,
            i_a: m.i_a,
            ln: m.ln,
            variance: m.variance,
            age_s,
        };
        curve.means().map(datum).collect::<Vec<_>>()
    };
    curves.iter().flat_map(of).collect()
}

/// R and L at one frequency over those at another that is near, by the pot's law at a middling current.
fn carried(known: Option<&Hypotheses>, from_hz: f64, to_hz: f64) -> [f64; 2] {
    const I_A: f64 = 15.0;
    let Some(known) = known else {
        // R as the skin effect's root.
        return [(to_hz / from_hz).sqrt(), 1.0];
    };
    let model = known.model();
    let (from, to) = (model.impedance(from_hz, I_A), model.impedance(to_hz, I_A));
    [to.r_ohm / from.r_ohm, to.l_h / from.l_h]
}
