//! The judge: findings about one result, and the verdict.

use ihd_identify::{Estimate, Method};
use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE, plausible};
use ihd_signal::{Remark, Segment, Severity};

use crate::comparison::{self, Difference};
use crate::interference;
use crate::remarks;
use crate::verdict::Judgement;
use crate::witness::Witness;

/// Mean error of R and of L in percent that is nobody's fault and must not be kept silent beyond.
pub const TOLERABLE_PCT: [f64; 2] = [1.0, 0.7];

/// Share of [`TOLERABLE_PCT`] from which on a difference is a warning: what is left belongs to the reference's own
/// error.
pub const WARNING_SHARE: f64 = 0.7;

/// A difference is noise below this many times what the standard deviations make of it. About 24 coefficients a
/// half-cycle scatter its mean by 15 %.
const NOISE_FACTOR: f64 = 2.0;

/// Largest mean standard deviation of R and of L in percent of the value.
pub const MAX_SIGMA_PCT: f64 = 3.0;

/// Least share of the half-cycles' middles that an estimate must span.
const LEAST_COVERED: f64 = 0.9;

/// What is known of one result.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Of survey and sensors, as far as they concern this segment.
    pub remarks: &'a [Remark],
    /// What was identified.
    pub segment: &'a Segment,
    /// What was found.
    pub estimate: &'a Estimate,
    /// What the segment says by itself.
    pub witness: &'a Witness,
}

/// Judges one result.
pub fn judge(evidence: &Evidence<'_>) -> Judgement {
    let Evidence {
        segment, estimate, ..
    } = *evidence;
    let mut findings: Vec<Remark> = evidence
        .remarks
        .iter()
        .chain(&evidence.witness.remarks)
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
    // What a filter thinks of itself is its tuning's: where the reference is sure and says the same, it counts.
    let within = |f: &Remark| f.severity != Severity::Error && f.value <= f.limit;
    let harmless = |f: &Remark| f.severity == Severity::Info || within(f);
    let confirmed = agreement.iter().all(harmless) && evidence.witness.reference.is_ok();
    let uncertain = match &evidence.witness.reference {
        Ok(reference) if confirmed => uncertainty(segment, reference),
        _ => uncertainty(segment, estimate),
    };
    if confirmed {
        // It stopped at a limit of steps, and at the right place.
        let unsettled = findings.iter_mut().filter(|f| f.code == "not_converged");
        unsettled.for_each(|f| f.severity = Severity::Info);
    }
    findings.extend(uncertain);
    findings.extend(agreement);
    findings.extend(plausibility(segment, estimate));
    Judgement::of(findings)
}

/// The judgement where a method failed.
pub fn failed(remarks: &[Remark], method: Method, why: &str) -> Judgement {
    let mut findings = remarks.to_vec();
    findings.push(Remark::new(
        "method_failed",
        Severity::Error,
        format!("{method} failed: {why}"),
    ));
    Judgement::of(findings)
}

fn coverage(segment: &Segment, estimate: &Estimate) -> Option<Remark> {
    let covered = comparison::covered(segment, estimate);
    (covered < LEAST_COVERED).then(|| {
        let text = format!(
            "only {:.0} % of the half-cycles' middles are identified: a part of the stretch was left out",
            100.0 * covered
        );
        Remark::new("not_covered", Severity::Warning, text)
            .with(100.0 * covered, Some(100.0 * LEAST_COVERED))
    })
}

/// The one of R and L that is further beyond its limit, its name and its limit.
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
    // A stretch of less than half a half-cycle has ends, where splines are free, and hardly a middle.
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

/// Against least squares, and least squares itself against the lock-in.
fn agreement(evidence: &Evidence<'_>) -> Vec<Remark> {
    let Evidence {
        segment,
        estimate,
        witness,
        ..
    } = *evidence;
    let reference = match &witness.reference {
        Ok(reference) => reference,
        Err(error) => {
            return vec![Remark::new(
                "no_reference",
                Severity::Warning,
                format!("there is nothing to check the result against: {error}"),
            )];
        }
    };
    let mut found = Vec::new();
    if let Some(apart) = worst(&comparison::differences(segment, estimate, reference)) {
        found.push(remark("disagreement", &apart, |pct, name, from_s| {
            format!(
                "{} differs from least squares by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: one of \
                 them does not fit this capture",
                estimate.method
            )
        }));
    }
    let cleaned = witness.cleaned.as_ref().unwrap_or(reference);
    let lockin = witness.lockin.as_ref().ok();
    let apart = lockin.and_then(|l| worst(&comparison::differences(segment, l, cleaned)));
    // Noise costs the lock-in more than least squares: that says nothing of the latter.
    if let Some(apart) = apart.filter(|apart| !is_noise(apart)) {
        let mut remark = remark("unconfirmed", &apart, |pct, name, from_s| {
            format!(
                "least squares and lock-in differ by {pct:.1} % of {name} in the half-cycle from {from_s:.4} s: the \
                 load, the frequency or the amplitude changes faster than they follow"
            )
        });
        if interference::disturbs_the_lockin(segment) {
            remark.severity = Severity::Info;
        }
        found.push(remark);
    }
    found
}

fn share(d: &Difference) -> f64 {
    (d.mean_pct[0] / TOLERABLE_PCT[0]).max(d.mean_pct[1] / TOLERABLE_PCT[1])
}

/// Whether the standard deviations of both explain it.
fn is_noise(d: &Difference) -> bool {
    (0..2).all(|k| {
        let small = d.mean_pct[k] <= WARNING_SHARE * TOLERABLE_PCT[k];
        small || d.mean_pct[k] <= NOISE_FACTOR * d.expected_pct[k]
    })
}

/// The worst difference, where it matters.
fn worst(all: &[Difference]) -> Option<Difference> {
    let worst = all.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    (share(worst) > WARNING_SHARE).then_some(*worst)
}

/// An error where the difference is more than is tolerable, and more than noise.
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

/// R in ohm and L in henry that a hob's lookup can hold, lowest and highest.
pub fn plausible_ranges() -> [(f64, f64); 2] {
    let of = |codes: &core::ops::RangeInclusive<u16>, unit: f64| {
        (
            f64::from(*codes.start()) * unit,
            f64::from(*codes.end()) * unit,
        )
    };
    [
        of(&plausible::R_CODES, OHM_PER_CODE),
        of(&plausible::L_CODES, HENRY_PER_CODE),
    ]
}

/// A warning: a scope may look at anything; the lookup refuses by itself. Near the zero crossings noise alone makes any
/// R and L.
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
