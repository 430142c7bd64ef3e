//! Judgement of one estimate: findings, and the verdict that follows from them.

use ihd_identify::pooled::SharedSigma;
use ihd_identify::{Estimate, Method};
use ihd_signal::{Remark, Segment, Severity};

use crate::comparison::{self, Difference};
use crate::interference;
use crate::limits::{MAX_SIGMA_PCT, TOLERABLE_PCT, WARNING_SHARE, plausible_ranges};
use crate::reference::ReferenceResults;
use crate::remarks;
use crate::verdict::{Gate, HalfCycleVerdict, Judgement, TOO_SHORT};

/// Largest ratio of a difference to that which the standard deviations explain, for a difference by noise. About 24
/// coefficients per half-cycle scatter its mean by 15 %.
const NOISE_FACTOR: f64 = 2.0;

/// Least share of the half-cycles' middles that an estimate must span.
const MIN_COVERED: f64 = 0.9;

/// Input of the judgement of one estimate.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Remarks of survey and sensors on this segment.
    pub remarks: &'a [Remark],
    /// Segment that was identified.
    pub segment: &'a Segment,
    /// Estimate to judge.
    pub estimate: &'a Estimate,
    /// Reference results for the segment.
    pub reference: &'a ReferenceResults,
    /// Standard deviations by the sensors and their correction, which the estimate does not contain.
    pub shared: SharedSigma,
}

/// Judges one estimate.
pub fn judge(evidence: &Evidence<'_>) -> Judgement {
    let Evidence {
        segment, estimate, ..
    } = *evidence;
    let mut findings: Vec<Remark> = evidence
        .remarks
        .iter()
        .chain(&evidence.reference.remarks)
        .map(|remark| remarks::for_method(remark, estimate.method))
        .chain(estimate.remarks.iter().cloned())
        .collect();
    if estimate.t_s.is_empty() {
        findings.push(Remark::new(
            "nothing_found",
            Severity::Error,
            format!("{} found no R and L in this stretch", estimate.method),
        ));
        return Judgement::from_findings(findings);
    }
    findings.extend(coverage(segment, estimate));
    findings.extend(plausibility(segment, estimate));
    let compared = ComparedEstimate::new(evidence);
    let uncertain = uncertainty(evidence, &compared.deviations(evidence));
    if compared.is_confirmed() {
        // The network stopped at its limit of steps, but with the right result.
        let unsettled = findings.iter_mut().filter(|f| f.code == "not_converged");
        unsettled.for_each(|f| f.severity = Severity::Info);
    }
    if evidence.reference.least_squares.is_err() {
        findings.push(no_reference(evidence.reference));
    }
    let half_cycles = [uncertain, compared.agreement].concat();
    let whole = findings.clone();
    findings.extend(worst_of_each_code(&half_cycles));
    let mut judgement = Judgement::from_findings(findings);
    judgement.half_cycles = verdicts(segment, &whole, &half_cycles);
    judgement
}

/// Estimate beside least squares of the same segment. Empty if least squares failed.
struct ComparedEstimate {
    /// Differences of the half-cycles.
    apart: Vec<Difference>,
    /// Remarks on them, and on those of least squares from the lock-in.
    agreement: Vec<HalfCycleRemark>,
    /// Deviations of least squares in percent, by half-cycle.
    known: Vec<(f64, [f64; 2])>,
    /// `true` if the estimate shares points enough with least squares in every judged half-cycle, of which there is one at least.
    is_complete: bool,
}

impl ComparedEstimate {
    fn new(evidence: &Evidence<'_>) -> Self {
        let segment = evidence.segment;
        let Ok(least_squares) = &evidence.reference.least_squares else {
            return Self {
                apart: Vec::new(),
                agreement: Vec::new(),
                known: Vec::new(),
                is_complete: false,
            };
        };
        let apart = comparison::differences(segment, evidence.estimate, least_squares);
        Self {
            agreement: agreement(evidence, &apart),
            known: comparison::sigmas_pct(segment, least_squares),
            is_complete: !apart.is_empty() && apart.len() == comparison::judged(segment).len(),
            apart,
        }
    }

    /// Returns `true` if nothing in the comparison speaks against the estimate.
    fn is_confirmed(&self) -> bool {
        let within = |f: &Remark| f.severity != Severity::Error && f.value <= f.limit;
        let harmless =
            |f: &HalfCycleRemark| f.remark.severity == Severity::Info || within(&f.remark);
        self.is_complete && self.agreement.iter().all(harmless)
    }

    /// Deviations of the half-cycles. A filter's σ follows from its tuning: if least squares agrees with the filter, its σ is used
    /// instead, and the smaller one if it does not refute it.
    fn deviations(&self, evidence: &Evidence<'_>) -> Vec<Deviations> {
        let (segment, estimate) = (evidence.segment, evidence.estimate);
        let is_error = |f: &HalfCycleRemark| f.remark.severity == Severity::Error;
        let is_refuted = self.agreement.iter().any(is_error);
        let sigmas = match &evidence.reference.least_squares {
            Ok(_) if self.is_confirmed() => self.known.clone(),
            Ok(_) if !is_refuted => within_reference(segment, estimate, &self.apart, &self.known),
            _ => comparison::sigmas_pct(segment, estimate),
        };
        deviations(evidence, &sigmas, &self.known)
    }
}

/// Remark on one half-cycle.
#[derive(Clone, Debug)]
struct HalfCycleRemark {
    crossing_s: f64,
    /// Value over its tolerable size.
    share: f64,
    remark: Remark,
}

/// Worst remark of each code.
fn worst_of_each_code(all: &[HalfCycleRemark]) -> Vec<Remark> {
    let mut worst: Vec<&HalfCycleRemark> = Vec::new();
    for one in all {
        match worst.iter_mut().find(|w| w.remark.code == one.remark.code) {
            Some(w) => {
                let rank = |f: &HalfCycleRemark| (f.remark.severity, f.share);
                if rank(one) > rank(w) {
                    *w = one;
                }
            }
            None => worst.push(one),
        }
    }
    worst.into_iter().map(|w| w.remark.clone()).collect()
}

/// Verdict on each half-cycle, from the findings on the whole segment and those of its own.
fn verdicts(
    segment: &Segment,
    whole: &[Remark],
    of_half_cycles: &[HalfCycleRemark],
) -> Vec<HalfCycleVerdict> {
    let judged = comparison::judged(segment);
    let verdict = |half: comparison::HalfCycleSpan| {
        let own = of_half_cycles
            .iter()
            .filter(|f| f.crossing_s == half.crossing_s);
        let mut findings: Vec<Remark> = own.map(|f| f.remark.clone()).collect();
        if !judged.contains(&half) {
            findings.push(left_out(100.0 * half.seen));
        }
        HalfCycleVerdict {
            from_s: half.crossing_s,
            seen: half.seen,
            gate: Gate::from_findings(whole.iter().chain(&findings)),
        }
    };
    let all = comparison::half_cycles(segment).into_iter();
    all.map(verdict).collect()
}

fn left_out(seen_pct: f64) -> Remark {
    let text = format!("only {seen_pct:.0} % of the half-cycle's middle was captured");
    Remark::new(TOO_SHORT, Severity::Info, text).with(seen_pct, Some(100.0 * comparison::MIN_SEEN))
}

/// Judges a method that failed.
pub fn judge_failure(remarks: &[Remark], method: Method, why: &str) -> Judgement {
    let mut findings = remarks.to_vec();
    findings.push(Remark::new(
        "method_failed",
        Severity::Error,
        format!("{method} failed: {why}"),
    ));
    Judgement::from_findings(findings)
}

fn coverage(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let covered = comparison::coverage(segment, estimate);
    (covered < MIN_COVERED).then(|| {
        let text = format!(
            "only {:.0} % of the half-cycles' middles are identified: a part of the stretch was left out",
            100.0 * covered
        );
        Remark::new("not_covered", Severity::Warning, text)
            .with(100.0 * covered, Some(100.0 * MIN_COVERED))
    })
}

/// The one of R and L that is further beyond its limit: name, value and limit.
fn worse(values: [f64; 2], limits: [f64; 2]) -> (&'static str, f64, f64) {
    if values[1] / limits[1] > values[0] / limits[0] {
        ("L", values[1], limits[1])
    } else {
        ("R", values[0], limits[0])
    }
}

/// Deviations of the half-cycles: `own` by noise, of which least squares knows those in `known`.
fn deviations(
    evidence: &Evidence<'_>,
    own: &[(f64, [f64; 2])],
    known: &[(f64, [f64; 2])],
) -> Vec<Deviations> {
    let shared = comparison::shared_pct(evidence.segment, evidence.estimate, &evidence.shared);
    let of = |all: &[(f64, [f64; 2])], crossing_s: f64| {
        let found = all.iter().find(|(at_s, _)| *at_s == crossing_s);
        found.map(|(_, pct)| *pct)
    };
    let deviations = own.iter().map(|&(crossing_s, own_pct)| Deviations {
        crossing_s,
        own_pct,
        known_pct: of(known, crossing_s),
        shared_pct: of(&shared, crossing_s).unwrap_or_default(),
    });
    deviations.collect()
}

/// Standard deviations of R and L in one half-cycle, in percent of the value.
struct Deviations {
    crossing_s: f64,
    /// Those by noise, that a method states.
    own_pct: [f64; 2],
    /// Those that least squares states; `None` if it failed there.
    known_pct: Option<[f64; 2]>,
    /// Those by the sensors and their correction.
    shared_pct: [f64; 2],
}

/// Remarks on the deviations of the half-cycles; [`TOO_SHORT`] if a stub is all there is, and its deviation is large or unknown.
fn uncertainty(evidence: &Evidence<'_>, deviations: &[Deviations]) -> Vec<HalfCycleRemark> {
    let segment = evidence.segment;
    let states_sigma = !evidence.estimate.r_sigma_ohm.is_empty();
    let judged = comparison::judged(segment);
    let Some(first) = judged.first() else {
        let crossing_s = comparison::half_cycles(segment)
            .first()
            .map(|h| h.crossing_s);
        let text = "the stretch holds no middle of a mains half-cycle: capture at least 10 ms";
        return vec![too_short(crossing_s.unwrap_or(segment.t0_s), text)];
    };
    let of = |half: &comparison::HalfCycleSpan| {
        let known = deviations.iter().find(|d| d.crossing_s == half.crossing_s);
        let Some(known) = known else {
            let text =
                "too few points were identified for a standard deviation: capture at least 10 ms";
            return states_sigma.then(|| too_short(half.crossing_s, text));
        };
        let most = known.own_pct[0].max(known.own_pct[1]);
        match !first.is_whole() && most > MAX_SIGMA_PCT {
            true => Some(known.of_a_stub(first.seen)),
            false => known.of_a_half_cycle(),
        }
    };
    judged.iter().filter_map(of).collect()
}

fn too_short(crossing_s: f64, text: &str) -> HalfCycleRemark {
    HalfCycleRemark {
        crossing_s,
        share: f64::INFINITY,
        remark: Remark::new(TOO_SHORT, Severity::Warning, text),
    }
}

impl Deviations {
    fn of_a_stub(&self, seen: f64) -> HalfCycleRemark {
        let [r, l] = self.own_pct;
        let text = format!(
            "R and L are uncertain by {r:.1} and {l:.1} %, because only {:.0} % of the half-cycle's middle was captured: capture \
             at least 10 ms",
            100.0 * seen
        );
        let remark = Remark::new(TOO_SHORT, Severity::Warning, text);
        let (_, value, tolerable) = worse(self.own_pct, TOLERABLE_PCT);
        HalfCycleRemark {
            crossing_s: self.crossing_s,
            share: value / tolerable,
            remark: remark.with(r.max(l), Some(MAX_SIGMA_PCT)),
        }
    }

    fn of_a_half_cycle(&self) -> Option<HalfCycleRemark> {
        let all: [f64; 2] = std::array::from_fn(|k| self.own_pct[k].hypot(self.shared_pct[k]));
        let is_error = |pct: [f64; 2]| pct[0].max(pct[1]) > MAX_SIGMA_PCT;
        let by_sensors = is_error(all) && !is_error(self.own_pct);
        let pct = if by_sensors { all } else { self.own_pct };
        let (severity, limits) = match is_error(pct) {
            true => (Severity::Error, [MAX_SIGMA_PCT; 2]),
            false => (
                Severity::Warning,
                TOLERABLE_PCT.map(|pct| WARNING_SHARE * pct),
            ),
        };
        let (name, value, limit) = worse(pct, limits);
        if value <= limit {
            return None;
        }
        let (_, most, tolerable) = worse(pct, TOLERABLE_PCT);
        let crossing_s = self.crossing_s;
        let of =
            format!("{name} uncertain by {value:.1} % in the half-cycle from {crossing_s:.4} s");
        let known = self.known_pct.map(|known| worse(known, TOLERABLE_PCT));
        // Noise is not the cause where least squares knows more of the same samples.
        let known = known.filter(|(_, known, limit)| known / limit < WARNING_SHARE);
        let text = match known {
            _ if by_sensors => format!("the sensors leave {of}: calibrate against a reference"),
            Some((_, known, _)) => {
                format!("this method leaves {of}, least squares by {known:.2} %: use least-squares")
            }
            None => {
                format!("noise leaves {of}: take a longer capture, a smaller range or more bits")
            }
        };
        Some(HalfCycleRemark {
            crossing_s,
            share: most / tolerable,
            remark: Remark::new("uncertain", severity, text).with(value, Some(limit)),
        })
    }
}

/// Standard deviations of an estimate that least squares does not refute, in percent, by half-cycle: its difference and the σ of
/// least squares, where its own states more.
fn within_reference(
    segment: &Segment,
    estimate: &Estimate,
    differences: &[Difference],
    known: &[(f64, [f64; 2])],
) -> Vec<(f64, [f64; 2])> {
    let mut sigmas = comparison::sigmas_pct(segment, estimate);
    for (crossing_s, own) in &mut sigmas {
        let apart = differences.iter().find(|d| d.crossing_s == *crossing_s);
        let of_reference = known.iter().find(|(at_s, _)| at_s == crossing_s);
        let (Some(apart), Some((_, of_reference))) = (apart, of_reference) else {
            continue;
        };
        for (k, own) in own.iter_mut().enumerate() {
            *own = own.min(apart.mean_pct[k].hypot(of_reference[k]));
        }
    }
    sigmas
}

fn no_reference(reference: &ReferenceResults) -> Remark {
    let why = reference.least_squares.as_ref().err();
    let why = why.map_or_else(String::new, ToString::to_string);
    Remark::new(
        "no_reference",
        Severity::Warning,
        format!("there is nothing to check the result against: {why}"),
    )
}

/// Compares the estimate with least squares, of which it is `apart`, and least squares with the lock-in, half-cycle by half-cycle.
fn agreement(evidence: &Evidence<'_>, apart: &[Difference]) -> Vec<HalfCycleRemark> {
    let Evidence {
        segment,
        estimate,
        reference,
        ..
    } = *evidence;
    let Ok(least_squares) = &reference.least_squares else {
        return Vec::new();
    };
    let mut findings = Vec::new();
    for apart in noticeable(apart) {
        findings.push(remark("disagreement", apart, |pct, name, from_s| {
            format!(
                "{} differs from least squares by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: one of \
                 them does not fit this capture",
                estimate.method
            )
        }));
    }
    let Ok(lockin) = &reference.lockin else {
        return findings;
    };
    let cleaned = reference.cleaned.as_ref().unwrap_or(least_squares);
    let disturbed = interference::disturbs_lockin(segment);
    // Noise costs the lock-in more than least squares, so a difference by noise does not question the latter.
    let all = comparison::differences(segment, lockin, cleaned);
    for apart in noticeable(&all).filter(|apart| !is_noise(apart)) {
        let mut found = remark("unconfirmed", apart, |pct, name, from_s| {
            format!(
                "least squares and lock-in differ by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: the \
                 load, the frequency or the amplitude changes faster than they follow"
            )
        });
        if disturbed {
            found.remark.severity = Severity::Info;
        }
        findings.push(found);
    }
    findings
}

/// Returns `true` if the standard deviations of both estimates explain the difference.
fn is_noise(d: &Difference) -> bool {
    (0..2).all(|k| {
        let small = d.mean_pct[k] <= WARNING_SHARE * TOLERABLE_PCT[k];
        small || d.mean_pct[k] <= NOISE_FACTOR * d.expected_pct[k]
    })
}

/// Differences from a warning on.
fn noticeable(all: &[Difference]) -> impl Iterator<Item = &Difference> {
    all.iter().filter(|d| d.share() > WARNING_SHARE)
}

/// Remark on a difference: an error if it is more than tolerable and more than the standard deviations explain, else a warning. Those
/// of filters and lock-in contain their difference from least squares ([`ihd_identify::run`]), so that theirs is a warning.
fn remark(
    code: &'static str,
    apart: &Difference,
    text: impl Fn(f64, &str, f64) -> String,
) -> HalfCycleRemark {
    let (name, pct, limit) = worse(apart.mean_pct, TOLERABLE_PCT);
    let severity = if pct > limit && !is_noise(apart) {
        Severity::Error
    } else {
        Severity::Warning
    };
    let remark = Remark::new(code, severity, text(pct, name, apart.crossing_s));
    HalfCycleRemark {
        crossing_s: apart.crossing_s,
        share: apart.share(),
        remark: remark.with(pct, Some(limit)),
    }
}

/// Factor beyond [`plausible_ranges`] from which a mean R or L comes of a wrong unit or probe.
const OUT_OF_SCALE: f64 = 10.0;

/// Warns of an R or L outside [`plausible_ranges`], because a scope may record anything and the lookup has its own check; means far
/// outside are an error. Points near the zero crossings are left out: noise alone can cause any R and L there.
fn plausibility(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let half_s = segment.half_cycle_s();
    let in_middle = |t: &f64| comparison::MIDDLE.contains(&(segment.since_crossing_s(*t) / half_s));
    let outside = |name, x: &[f64], (low, high): (f64, f64), unit, scale: f64| {
        let middle = estimate.t_s.iter().zip(x).filter(|(t, _)| in_middle(t));
        let values: Vec<f64> = middle.map(|(_, x)| *x).collect();
        let value = *values.iter().find(|x| !(low..=high).contains(*x))?;
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let is_far = !(low / OUT_OF_SCALE..=OUT_OF_SCALE * high).contains(&mean);
        let (verb, shown, severity) = match is_far {
            true => ("is", mean, Severity::Error),
            false => ("reaches", value, Severity::Warning),
        };
        let text = format!(
            "{name} {verb} {:.3} {unit}, which no hob has ({:.2}-{:.1} {unit}): check the probes' factors (--input probe) and units",
            shown * scale,
            low * scale,
            high * scale
        );
        Some(Remark::new("implausible_load", severity, text).with(shown, None))
    };
    let [r_range, l_range] = plausible_ranges();
    let r = outside("R", &estimate.r_ohm, r_range, "Ω", 1.0);
    let l = outside("L", &estimate.l_h, l_range, "µH", 1e6);
    l.into_iter().chain(r).max_by_key(|f| f.severity)
}
