//! Hypotheses on one pot: it is any pot, or one that another hob knows. Each is weighted by the likelihood of the measured
//! data.
//!
//! Cells are the mixture's mean, and their deviations contain the spread between hypotheses. "Any pot" keeps a share whatever
//! the evidence: windows of one frequency cannot separate pots that differ at others.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::curve::{CurrentCurve, Mean, common_covariance};
use crate::fit::Datum;
use crate::library::{Candidate, Library, Shape, ShapeState, shape_places, without};
use crate::posterior::{Posterior, RlPrediction};
use crate::pot_fit::PotFit;

/// Prior share of each entry: one of forty pots that may come. All entries together have half at most.
const ENTRY_SHARE: f64 = 1.0 / 40.0;
const MAX_ENTRIES_SHARE: f64 = 0.5;

/// Least share of "any pot", whatever the evidence. An entry is advice: it may be another pot, or forged to fit all that this hob
/// has measured. With [`MAX_DEVIATIONS`], all entries together then move the map by at most one of this hob's own deviations in the mean
/// of the squares, and what they add to the deviations keeps a wrong cell from being marked (docs/map.md).
const MIN_ANY_POT_SHARE: f64 = 0.5;

/// Most deviations of "any pot", root mean square over the map, by which an entry's map may differ from it: docs/map.md
/// finds them too small by 1.7 at most.
const MAX_DEVIATIONS: f64 = 2.0;

/// Least relative deviations of R and L in that comparison.
const MIN_SIGMA: [f64; 2] = [0.004, 0.002];

/// Share below which a hypothesis is dropped.
const DROPPED: f64 = 0.01;

/// Hypothesis that the pot is one of the library's.
#[derive(Clone, Debug)]
struct LibraryHypothesis {
    entry: String,
    share: f64,
    shape: Shape,
    /// Fit of the physics to the data less the entry's shape.
    posterior: Posterior,
}

/// Weighted hypotheses on one pot.
#[derive(Clone, Debug)]
pub(crate) struct Hypotheses {
    /// Hypothesis that it is any pot.
    any: Posterior,
    others: Vec<LibraryHypothesis>,
}

/// Stored form of a library hypothesis.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct LibraryHypothesisState {
    entry: String,
    share: f64,
    shape: ShapeState,
    #[serde(rename = "ended")]
    fit: PotFit,
}

impl LibraryHypothesis {
    fn candidate(&self) -> Candidate {
        Candidate {
            id: self.entry.clone(),
            prior: self.posterior.fit().prior(),
            shape: self.shape.clone(),
        }
    }

    /// Returns `true` if the entry's map lies within the deviations of this hob's own map, in cells measured or not. An honest
    /// entry knows more and contradicts nothing; one made to fit the first measurements and to be wrong elsewhere does not pass.
    fn is_believable(&self, alone: &[RlPrediction]) -> bool {
        let square = |(value, alone): (&RlPrediction, &RlPrediction)| {
            let r = (value.r_ohm / alone.r_ohm).ln() / alone.r_sigma.hypot(MIN_SIGMA[0]);
            let l = (value.l_h / alone.l_h).ln() / alone.l_sigma.hypot(MIN_SIGMA[1]);
            0.5 * (r * r + l * l)
        };
        let values = self.at(&shape_places(), 0.0);
        let squares: f64 = values.iter().zip(alone).map(square).sum();
        squares < MAX_DEVIATIONS * MAX_DEVIATIONS * alone.len() as f64
    }

    fn at(&self, places: &[(f64, f64)], ahead_s: f64) -> Vec<RlPrediction> {
        let mut all = self.posterior.at(places, ahead_s);
        for (value, &(f_hz, i_a)) in all.iter_mut().zip(places) {
            let beside = self.shape.at(f_hz, i_a);
            let variance = self.shape.variance(f_hz, i_a);
            value.r_ohm *= beside[0].exp();
            value.l_h *= beside[1].exp();
            value.r_sigma = (value.r_sigma.powi(2) + variance[0]).sqrt();
            value.l_sigma = (value.l_sigma.powi(2) + variance[1]).sqrt();
        }
        all
    }

    fn compare(&self, f_hz: f64, means: &[Mean], ahead_s: f64) -> Option<Comparison> {
        let less = |m: &Mean| {
            let (beside, variance) = (self.shape.at(f_hz, m.i_a), self.shape.variance(f_hz, m.i_a));
            Mean {
                i_a: m.i_a,
                ln: [0, 1].map(|x| m.ln[x] - beside[x]),
                variance: [0, 1].map(|x| m.variance[x] + variance[x]),
                level: m.level,
                common: m.common,
            }
        };
        let means: Vec<_> = means.iter().map(less).collect();
        compare(&self.posterior, f_hz, &means, ahead_s)
    }
}

impl LibraryHypothesisState {
    fn is_sound(&self) -> bool {
        self.fit.is_sound() && self.shape.is_sound() && self.share > 0.0
    }
}

/// Comparison of a window with the expectation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// Mean square in variances under the hypothesis that expected the window best.
    pub chi2: f64,
    /// Root mean squares of the relative differences of R and L from that expectation.
    pub off: [f64; 2],
    /// Mean square in variances under the hypothesis that expected the window worst.
    pub most_chi2: f64,
}

impl Hypotheses {
    /// Fits all hypotheses to the data; `before` is the last result, and `again` queries the library anew. `None` under the
    /// conditions of [`Posterior::from_data`].
    pub fn fit(
        data: Vec<Datum>,
        library: Option<&Library>,
        before: Option<&Self>,
        again: bool,
    ) -> Option<Self> {
        let any = Posterior::from_data(data.clone(), None, before.map(|b| b.any.fit()))?;
        let last = before.map_or(&[][..], |b| &b.others);
        let candidates = match library {
            Some(library) if again => library.candidates(&data),
            _ => last.iter().map(LibraryHypothesis::candidate).collect(),
        };
        let others = candidates.into_iter().filter_map(|candidate| {
            let start = last.iter().find(|r| r.entry == candidate.id);
            let start = start.map(|r| r.posterior.fit());
            let alone = without(&candidate.shape, &data);
            Some(LibraryHypothesis {
                posterior: Posterior::from_data(alone, Some(&candidate.prior), start)?,
                entry: candidate.id,
                share: 0.0,
                shape: candidate.shape,
            })
        });
        let entries = library.map_or(1, |l| l.entries().len()).max(1) as f64;
        Some(Self::weight(any, others.collect(), entries))
    }

    /// Computes the shares from the evidence.
    fn weight(any: Posterior, mut others: Vec<LibraryHypothesis>, entries: f64) -> Self {
        if !others.is_empty() {
            let alone = any.at(&shape_places(), 0.0);
            others.retain(|r| r.is_believable(&alone));
        }
        let highest = others.iter().map(|r| r.posterior.evidence());
        let highest = highest.fold(any.evidence(), f64::max);
        let of_all = MAX_ENTRIES_SHARE.min(entries * ENTRY_SHARE);
        let none = (1.0 - of_all) * (any.evidence() - highest).exp();
        for r in &mut others {
            r.share = of_all / entries * (r.posterior.evidence() - highest).exp();
        }
        let sum: f64 = none + others.iter().map(|r| r.share).sum::<f64>();
        others.retain(|r| r.share >= DROPPED * sum);
        let left: f64 = others.iter().map(|r| r.share).sum();
        let most = (left / (none + left)).min(1.0 - MIN_ANY_POT_SHARE);
        others.iter_mut().for_each(|r| r.share *= most / left);
        Self { any, others }
    }

    /// Stored form of the library's hypotheses.
    pub fn state(&self) -> Vec<LibraryHypothesisState> {
        let state = |r: &LibraryHypothesis| LibraryHypothesisState {
            entry: r.entry.clone(),
            share: r.share,
            shape: r.shape.state().clone(),
            fit: *r.posterior.fit(),
        };
        self.others.iter().map(state).collect()
    }

    /// Restores hypotheses from their stored form and the data; `None` if no data can have produced them.
    pub fn from_state(
        any: PotFit,
        others: Vec<LibraryHypothesisState>,
        data: Vec<Datum>,
    ) -> Option<Self> {
        let sum: f64 = others.iter().map(|r| r.share).sum();
        // A share that is no number is none either.
        let within = sum < 1.0;
        if !within || !any.is_sound() || !others.iter().all(LibraryHypothesisState::is_sound) {
            return None;
        }
        let restored = others.into_iter().map(|r| {
            let shape = Shape::from_state(r.shape);
            Some(LibraryHypothesis {
                posterior: Posterior::conditioned(r.fit, without(&shape, &data))?,
                entry: r.entry,
                share: r.share,
                shape,
            })
        });
        Some(Self {
            others: restored.collect::<Option<_>>()?,
            any: Posterior::conditioned(any, data)?,
        })
    }

    /// Hypothesis "any pot": the result of this hob's own windows.
    pub fn any(&self) -> &Posterior {
        &self.any
    }

    /// Entries of the library that the pot may be, with their shares.
    pub fn recognised(&self) -> impl Iterator<Item = (&str, f64)> {
        self.others.iter().map(|r| (r.entry.as_str(), r.share))
    }

    /// Share of "any pot".
    fn share_of_any(&self) -> f64 {
        1.0 - self.others.iter().map(|r| r.share).sum::<f64>()
    }

    fn likeliest(&self) -> &Posterior {
        let best = self
            .others
            .iter()
            .max_by(|a, b| a.share.total_cmp(&b.share));
        let best = best.filter(|r| r.share > self.share_of_any());
        best.map_or(&self.any, |r| &r.posterior)
    }

    /// Pot under the likeliest hypothesis.
    pub fn model(&self) -> PotModel {
        self.likeliest().fit().model()
    }

    /// R and L with their deviations at places, `ahead_s` seconds after the last datum.
    pub fn at(&self, places: &[(f64, f64)], ahead_s: f64) -> Vec<RlPrediction> {
        if self.others.is_empty() {
            return self.any.at(places, ahead_s);
        }
        let others = self.others.iter();
        let mut each: Vec<_> = others.map(|r| (r.share, r.at(places, ahead_s))).collect();
        each.push((self.share_of_any(), self.any.at(places, ahead_s)));
        let mixed = |k: usize, x: fn(&RlPrediction) -> (f64, f64)| {
            let of = each.iter().map(|(share, all)| (*share, x(&all[k])));
            let mean: f64 = of.clone().map(|(share, (x, _))| share * x.ln()).sum();
            let variance: f64 = of
                .map(|(share, (x, sigma))| share * (sigma * sigma + (x.ln() - mean).powi(2)))
                .sum();
            (mean.exp(), variance.sqrt())
        };
        (0..places.len())
            .map(|k| {
                let (r_ohm, r_sigma) = mixed(k, |p| (p.r_ohm, p.r_sigma));
                let (l_h, l_sigma) = mixed(k, |p| (p.l_h, p.l_sigma));
                RlPrediction {
                    r_ohm,
                    l_h,
                    r_sigma,
                    l_sigma,
                }
            })
            .collect()
    }

    /// Compares a window's `means` with the expectation of each hypothesis; `None` if none has an expectation.
    ///
    /// The best one counts: the pot is another one only if it differs under every hypothesis. A wrong entry therefore never
    /// discards a map.
    pub fn compare(
        &self,
        curve: &CurrentCurve,
        means: &[Mean],
        ahead_s: f64,
    ) -> Option<Comparison> {
        let f_hz = curve.f_sw_hz;
        let others = self.others.iter();
        let others = others.filter_map(|r| r.compare(f_hz, means, ahead_s));
        let any = compare(&self.any, f_hz, means, ahead_s);
        any.into_iter().chain(others).reduce(|a, b| {
            let best = if b.chi2 < a.chi2 { b } else { a };
            Comparison {
                most_chi2: a.most_chi2.max(b.most_chi2),
                ..best
            }
        })
    }
}

fn compare(posterior: &Posterior, f_hz: f64, means: &[Mean], ahead_s: f64) -> Option<Comparison> {
    let places: Vec<_> = means.iter().map(|m| (f_hz, m.i_a)).collect();
    let (expected, mut covariance) = posterior.joint(&places, ahead_s);
    let count = means.len();
    let off = DVector::from_fn(2 * count, |k, _| {
        means[k % count].ln[k / count] - expected[k]
    });
    for (k, mean) in means.iter().enumerate() {
        for x in 0..2 {
            let first = x * count;
            covariance[(first + k, first + k)] += mean.variance[x];
            // One curve has one level.
            for (n, other) in means.iter().enumerate() {
                covariance[(first + k, first + n)] +=
                    mean.level[x] + common_covariance(mean.common[x], other.common[x]);
            }
        }
    }
    let mean_square = |x: usize| off.rows(x * count, count).norm_squared() / count as f64;
    let chi2 = off.dot(&covariance.cholesky()?.solve(&off)) / (2 * count) as f64;
    Some(Comparison {
        chi2,
        off: [0, 1].map(|x| mean_square(x).sqrt()),
        most_chi2: chi2,
    })
}
