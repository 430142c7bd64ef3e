//! Judgement of a result: its error, if that was reported, and its error over its own σ.

use ihd_gate::MethodResult;
use ihd_identify::Estimate;
use ihd_identify::trajectory::TrajectoryCursor;
use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use ihd_sim::recording::settings::CaptureSpec;
use serde::Serialize;

use super::case::CaptureGroup;

/// Mean error of R over the middle of a half-cycle above which a finding is required, in percent.
pub const LIMIT_R_PCT: f64 = 1.0;

/// Mean error of L over the middle of a half-cycle above which a finding is required, in percent.
pub const LIMIT_L_PCT: f64 = 0.7;

/// Number of periods in the middle of a half-cycle below which it is not judged.
const MIN_PERIODS: usize = 10;

/// Part of a half-cycle that counts, as shares.
const MIDDLE: std::ops::RangeInclusive<f64> = 0.1..=0.9;

/// Errors of one stretch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StretchErrors {
    /// Mean |error| of R over the middle 80 % of a half-cycle in percent, of the worst half-cycle.
    pub r_pct: f64,
    /// Mean |error| of L over the middle 80 % of a half-cycle in percent, of the worst half-cycle.
    pub l_pct: f64,
    /// Root mean square of error over σ, of R or L, whichever is larger; `None` without σ.
    pub per_sigma: Option<f64>,
}

impl StretchErrors {
    /// Returns `true` if a finding is required.
    pub fn exceed(&self) -> bool {
        !(self.r_pct <= LIMIT_R_PCT && self.l_pct <= LIMIT_L_PCT)
    }

    /// The larger of both, number by number.
    pub fn or_worse(self, other: Self) -> Self {
        Self {
            r_pct: self.r_pct.max(other.r_pct),
            l_pct: self.l_pct.max(other.l_pct),
            per_sigma: larger(self.per_sigma, other.per_sigma),
        }
    }
}

/// The larger of both, or the only one.
pub(super) fn larger(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).reduce(f64::max)
}

/// Judgement of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ResultJudgement {
    /// Correct, and passed.
    Right,
    /// Correct, passed with a warning.
    Warned,
    /// Wrong, and reported: with a warning or a refusal.
    Said,
    /// Refused although correct, for a faulty capture.
    Careful,
    /// Refused although correct, for a clean capture.
    FalselyRefused,
    /// Wrong without a finding, and no capture can show it.
    Invisible,
    /// Wrong without a finding.
    Silent,
}

impl ResultJudgement {
    /// Derives the judgement from errors and findings.
    pub fn judge(
        group: CaptureGroup,
        errors: Option<StretchErrors>,
        refused: bool,
        warned: bool,
    ) -> Self {
        match errors {
            Some(e) if e.exceed() && (refused || warned) => Self::Said,
            Some(e) if e.exceed() && group == CaptureGroup::Invisible => Self::Invisible,
            Some(e) if e.exceed() => Self::Silent,
            // A clean capture without any estimate counts as refused.
            _ if refused && group == CaptureGroup::Clean => Self::FalselyRefused,
            None => Self::Said,
            Some(_) if refused => Self::Careful,
            Some(_) if warned => Self::Warned,
            Some(_) => Self::Right,
        }
    }
}

/// Truth of a case, with the mains of the simulation: an estimator's own idea of the mains must not decide which periods count.
pub struct CaseTruth<'a> {
    /// Periods in order of time, without those beside an event.
    periods: Vec<&'a PeriodTruth>,
    half_cycle_s: f64,
    start_s: f64,
}

impl<'a> CaseTruth<'a> {
    /// Creates the truth of a recording. The two periods beside an event, whose sums mix both loads, are skipped.
    pub fn new(settings: &CaptureSpec, truth: &'a [PeriodTruth]) -> Self {
        let beside = |t: &PeriodTruth| {
            let mut events = settings.events.iter();
            events.any(|e| (t.t_s - e.t_s).abs() < 2.5 / t.f_sw_hz)
        };
        Self {
            periods: truth.iter().filter(|t| !beside(t)).collect(),
            half_cycle_s: 0.5 / settings.mains_hz,
            start_s: settings.start_s,
        }
    }

    /// Errors of an estimate of `segment`; `None` if both have no middle of a half-cycle in common.
    pub fn errors(&self, estimate: &Estimate, segment: &Segment) -> Option<StretchErrors> {
        let inside = segment.t0_s..=segment.t_s(segment.len());
        let mut trajectory = TrajectoryCursor::from(estimate, f64::NEG_INFINITY)?;
        let mut halves: Vec<Sums> = Vec::new();
        for t in self.periods.iter().filter(|t| inside.contains(&t.t_s)) {
            let at = (t.t_s + self.start_s) / self.half_cycle_s;
            if !MIDDLE.contains(&at.fract()) {
                continue;
            }
            if halves.last().is_none_or(|half| half.number != at.floor()) {
                halves.push(Sums::new(at.floor()));
            }
            let (r_ohm, l_h) = trajectory.r_l(t.t_s);
            let sigma = trajectory.sigma(t.t_s);
            if let Some(half) = halves.last_mut() {
                half.add([r_ohm, l_h], [t.r_ohm[0], t.l_h[0]], sigma);
            }
        }
        halves.retain(|half| half.n >= MIN_PERIODS);
        halves
            .iter()
            .map(Sums::errors)
            .reduce(StretchErrors::or_worse)
    }
}

/// Sums over a half-cycle.
struct Sums {
    number: f64,
    n: usize,
    relative: [f64; 2],
    per_sigma: Option<[f64; 2]>,
}

impl Sums {
    fn new(number: f64) -> Self {
        Self {
            number,
            n: 0,
            relative: [0.0; 2],
            per_sigma: Some([0.0; 2]),
        }
    }

    fn add(&mut self, estimate: [f64; 2], truth: [f64; 2], sigma: Option<(f64, f64)>) {
        self.n += 1;
        for k in 0..2 {
            self.relative[k] += (estimate[k] / truth[k] - 1.0).abs();
        }
        self.per_sigma = self.per_sigma.zip(sigma).map(|(sums, (r, l))| {
            let square = |k: usize, sigma: f64| {
                ((estimate[k] - truth[k]) / sigma.max(f64::MIN_POSITIVE)).powi(2)
            };
            [sums[0] + square(0, r), sums[1] + square(1, l)]
        });
    }

    fn errors(&self) -> StretchErrors {
        let n = self.n as f64;
        StretchErrors {
            r_pct: 100.0 * self.relative[0] / n,
            l_pct: 100.0 * self.relative[1] / n,
            per_sigma: self.per_sigma.map(|s| (s[0].max(s[1]) / n).sqrt()),
        }
    }
}

/// Errors of an outcome; `None` without an estimate or without truth to compare with.
pub fn errors(
    truth: &CaseTruth<'_>,
    outcome: &MethodResult,
    segments: &[Segment],
) -> Option<StretchErrors> {
    let estimate = outcome.result.as_ref().ok()?;
    truth.errors(estimate, segments.get(outcome.segment)?)
}

#[cfg(test)]
mod tests {
    use ihd_identify::Method;

    use super::*;

    fn period(t_s: f64) -> PeriodTruth {
        PeriodTruth {
            t_s,
            f_sw_hz: 50e3,
            r_ohm: [2.0; 4],
            l_h: [20e-6; 4],
            i_a: 10.0,
            r_power_ohm: 2.0,
            p_w: 100.0,
        }
    }

    fn segment() -> Segment {
        Segment {
            f_sw_hz: 50e3,
            // Whatever an estimator took the mains for.
            mains_hz: 63.0,
            zero_crossing_s: 1e-3,
            t0_s: 0.0,
            dt_s: 1e-6,
            v_v: vec![0.0; 20_000].into(),
            i_a: vec![0.0; 20_000].into(),
        }
    }

    /// 1 % too much in the first half-cycle, 3 % in the second; σ of 1 %.
    #[test]
    fn the_worst_half_cycle_counts_and_its_edges_do_not() {
        let periods: Vec<_> = (0..1000).map(|k| period(f64::from(k) * 20e-6)).collect();
        let settings = CaptureSpec::default();
        let truth = CaseTruth::new(&settings, &periods);
        let mut estimate = Estimate::new(Method::Lockin, 50e3);
        for k in 0..1000 {
            let t_s = f64::from(k) * 20e-6;
            let factor = match t_s {
                t if (0.95e-3..9.05e-3).contains(&t) => 1.01,
                t if (10.95e-3..19.05e-3).contains(&t) => 1.03,
                _ => 9.0,
            };
            estimate.t_s.push(t_s);
            estimate.r_ohm.push(2.0 * factor);
            estimate.l_h.push(20e-6);
            estimate.r_sigma_ohm.push(0.02);
            estimate.l_sigma_h.push(1e-6);
        }
        let found = truth.errors(&estimate, &segment()).unwrap();
        assert!((found.r_pct - 3.0).abs() < 1e-9, "{found:?}");
        assert!(found.l_pct.abs() < 1e-9);
        assert!((found.per_sigma.unwrap() - 3.0).abs() < 1e-9);
        assert!(found.exceed());
    }

    #[test]
    fn a_word_saves_a_wrong_result_and_a_refusal_costs_a_right_one() {
        let (right, wrong) = (
            Some(StretchErrors::default()),
            Some(StretchErrors {
                r_pct: f64::NAN,
                ..StretchErrors::default()
            }),
        );
        let of = |errors, refused, warned| {
            ResultJudgement::judge(CaptureGroup::Clean, errors, refused, warned)
        };
        assert_eq!(of(wrong, false, false), ResultJudgement::Silent);
        assert_eq!(of(wrong, false, true), ResultJudgement::Said);
        assert_eq!(of(wrong, true, false), ResultJudgement::Said);
        assert_eq!(of(right, true, false), ResultJudgement::FalselyRefused);
        assert_eq!(of(None, true, false), ResultJudgement::FalselyRefused);
        assert_eq!(of(right, false, true), ResultJudgement::Warned);
        assert_eq!(of(right, false, false), ResultJudgement::Right);
        assert_eq!(
            ResultJudgement::judge(CaptureGroup::Faulty, right, true, false),
            ResultJudgement::Careful
        );
        let invisible =
            |warned| ResultJudgement::judge(CaptureGroup::Invisible, wrong, false, warned);
        assert_eq!(invisible(false), ResultJudgement::Invisible);
        assert_eq!(invisible(true), ResultJudgement::Said);
    }
}
