//! Judgement of one estimate: findings, and the verdict that follows from them.

use ihd_identify::{Estimate, Method};
use ihd_signal::{Remark, Segment, Severity};

use crate::comparison::{self, Difference};
use crate::interference;
use crate::limits::{MAX_SIGMA_PCT, TOLERABLE_PCT, WARNING_SHARE, plausible_ranges};
use crate::reference::Reference;
use crate::remarks;
use crate::verdict::Judgement;

/// Largest ratio of a difference to that which the standard deviations explain, for a difference by noise. About 24
/// coefficients per half-cycle scatter its mean by 15 %.
const NOISE_FACTOR: f64 = 2.0;

/// Least share of the half-cycles' middles that an estimate must span.
const LEAST_COVERED: f64 = 0.9;

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
    pub reference: &'a Reference,
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
        return Judgement::of(findings);
    }
    findings.extend(coverage(segment, estimate));
    let agreement = agreement(evidence);
    // A filter's σ follows from its tuning; if the reference agrees with the filter, the reference's σ is used instead.
    let within = |f: &Remark| f.severity != Severity::Error && f.value <= f.limit;
    let harmless = |f: &Remark| f.severity == Severity::Info || within(f);
    let confirmed = agreement.iter().all(harmless) && evidence.reference.least_squares.is_ok();
    let uncertain = match &evidence.reference.least_squares {
        Ok(reference) if confirmed => uncertainty(segment, reference),
        _ => uncertainty(segment, estimate),
    };
    if confirmed {
        // The network stopped at its limit of steps, but with the right result.
        let unsettled = findings.iter_mut().filter(|f| f.code == "not_converged");
        unsettled.for_each(|f| f.severity = Severity::Info);
    }
    findings.extend(uncertain);
    findings.extend(agreement);
    findings.extend(plausibility(segment, estimate));
    Judgement::of(findings)
}

/// Judges a method that failed.
pub fn judge_failure(remarks: &[Remark], method: Method, why: &str) -> Judgement {
    let mut findings = remarks.to_vec();
    findings.push(Remark::new(
        "method_failed",
        Severity::Error,
        format!("{method} failed: {why}"),
    ));
    Judgement::of(findings)
}

fn coverage(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let covered = comparison::coverage(segment, estimate);
    (covered < LEAST_COVERED).then(|| {
        let text = format!(
            "only {:.0} % of the half-cycles' middles are identified: a part of the stretch was left out",
            100.0 * covered
        );
        Remark::new("not_covered", Severity::Warning, text)
            .with(100.0 * covered, Some(100.0 * LEAST_COVERED))
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

fn uncertainty(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let sigmas = comparison::sigmas_pct(segment, estimate);
    let share = |pct: &[f64; 2]| (pct[0] / TOLERABLE_PCT[0]).max(pct[1] / TOLERABLE_PCT[1]);
    let (crossing_s, pct) = sigmas
        .into_iter()
        .max_by(|a, b| share(&a.1).total_cmp(&share(&b.1)))?;
    let (name, value, tolerable) = worse(pct, TOLERABLE_PCT);
    // Splines are free at the ends of a stretch; one shorter than half a half-cycle has hardly anything else.
    let whole = segment.len() as f64 * segment.dt_s >= 0.5 * segment.half_cycle_s();
    let (severity, limit) = if whole && pct[0].max(pct[1]) > MAX_SIGMA_PCT {
        (Severity::Error, MAX_SIGMA_PCT)
    } else {
        (Severity::Warning, WARNING_SHARE * tolerable)
    };
    (value > WARNING_SHARE * tolerable).then(|| {
        let text = format!(
            "noise leaves {name} uncertain by {value:.1} % in the half-cycle from {crossing_s:.4} s: take a longer \
             capture, a smaller range or more bits"
        );
        Remark::new("uncertain", severity, text).with(value, Some(limit))
    })
}

/// Compares the estimate with least squares, and least squares with the lock-in.
fn agreement(evidence: &Evidence<'_>) -> Vec<Remark> {
    let Evidence {
        segment,
        estimate,
        reference,
        ..
    } = *evidence;
    let least_squares = match &reference.least_squares {
        Ok(least_squares) => least_squares,
        Err(error) => {
            return vec![Remark::new(
                "no_reference",
                Severity::Warning,
                format!("there is nothing to check the result against: {error}"),
            )];
        }
    };
    let mut findings = Vec::new();
    if let Some(apart) = worst(&comparison::differences(segment, estimate, least_squares)) {
        findings.push(remark("disagreement", &apart, |pct, name, from_s| {
            format!(
                "{} differs from least squares by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: one of \
                 them does not fit this capture",
                estimate.method
            )
        }));
    }
    let cleaned = reference.cleaned.as_ref().unwrap_or(least_squares);
    let lockin = reference.lockin.as_ref().ok();
    let apart = lockin.and_then(|l| worst(&comparison::differences(segment, l, cleaned)));
    // Noise costs the lock-in more than least squares, so a difference by noise does not question the latter.
    if let Some(apart) = apart.filter(|apart| !is_noise(apart)) {
        let mut remark = remark("unconfirmed", &apart, |pct, name, from_s| {
            format!(
                "least squares and lock-in differ by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: the \
                 load, the frequency or the amplitude changes faster than they follow"
            )
        });
        if interference::disturbs_lockin(segment) {
            remark.severity = Severity::Info;
        }
        findings.push(remark);
    }
    findings
}

fn share(d: &Difference) -> f64 {
    (d.mean_pct[0] / TOLERABLE_PCT[0]).max(d.mean_pct[1] / TOLERABLE_PCT[1])
}

/// Returns `true` if the standard deviations of both estimates explain the difference.
fn is_noise(d: &Difference) -> bool {
    (0..2).all(|k| {
        let small = d.mean_pct[k] <= WARNING_SHARE * TOLERABLE_PCT[k];
        small || d.mean_pct[k] <= NOISE_FACTOR * d.expected_pct[k]
    })
}

/// Worst difference; `None` if all are below the warning.
fn worst(all: &[Difference]) -> Option<Difference> {
    let worst = all.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    (share(worst) > WARNING_SHARE).then_some(*worst)
}

/// Remark on a difference: an error if it is more than tolerable and more than noise, else a warning.
fn remark(
    code: &'static str,
    apart: &Difference,
    text: impl Fn(f64, &str, f64) -> String,
) -> Remark {
    let (name, pct, limit) = worse(apart.mean_pct, TOLERABLE_PCT);
    let severity = if pct > limit && !is_noise(apart) {
        Severity::Error
    } else {
        Severity::Warning
    };
    Remark::new(code, severity, text(pct, name, apart.crossing_s)).with(pct, Some(limit))
}

/// Warns of an R or L outside [`plausible_ranges`]. It is no error, because a scope may record anything and the lookup has
/// its own check. Points near the zero crossings are left out: noise alone can cause any R and L there.
fn plausibility(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let [r_range, l_range] = plausible_ranges();
    let half_s = segment.half_cycle_s();
    let in_middle = |t: &f64| comparison::MIDDLE.contains(&(segment.since_crossing_s(*t) / half_s));
    let outside = |x: &[f64], (low, high): (f64, f64)| {
        let middle = estimate.t_s.iter().zip(x).filter(|(t, _)| in_middle(t));
        let mut values = middle.map(|(_, x)| *x);
        values.find(|x| !(low..=high).contains(x))
    };
    let (text, value) = if let Some(r) = outside(&estimate.r_ohm, r_range) {
        (
            format!("R reaches {r:.3} Ω, which no hob's pot has (0.02-15.9 Ω)"),
            r,
        )
    } else {
        let l = outside(&estimate.l_h, l_range)?;
        let text = format!(
            "L reaches {:.2} µH, which no hob's coil has (2-63.9 µH)",
            l * 1e6
        );
        (text, l)
    };
    Some(Remark::new("implausible_load", Severity::Warning, text).with(value, None))
}
