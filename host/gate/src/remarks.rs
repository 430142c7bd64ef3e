//! Which remarks concern which result.

use ihd_identify::Method;
use ihd_signal::{Remark, Segment, Severity};
use ihd_survey::{Channel, Finding, Survey};

/// Codes that cost only those methods something that work in the time domain, sample by sample: phasors do not see
/// what lies between the harmonics, nor a mean.
const TIME_DOMAIN_ONLY: [&str; 2] = ["coarsely_sampled", "offset"];

/// What noise costs stands in σ and in the agreement with the reference, which the gate looks at: the ratio by itself
/// costs nothing.
const JUDGED_BY_SIGMA: &str = "noisy";

/// Whether a method works with phasors.
fn works_with_phasors(method: Method) -> bool {
    matches!(
        method,
        Method::Lockin | Method::LeastSquares | Method::Pinn | Method::Firmware
    )
}

/// A remark as it concerns a method.
pub fn for_method(remark: &Remark, method: Method) -> Remark {
    let mut remark = remark.clone();
    let elsewhere = TIME_DOMAIN_ONLY.contains(&remark.code) && works_with_phasors(method);
    if remark.severity == Severity::Warning && (elsewhere || remark.code == JUDGED_BY_SIGMA) {
        remark.severity = Severity::Info;
    }
    remark
}

/// What the survey found, as far as it concerns a segment of the capture.
pub fn of_survey(survey: &Survey, segment: &Segment) -> Vec<Remark> {
    survey
        .findings
        .iter()
        .filter(|finding| concerns(finding, segment))
        .map(Finding::remark)
        .collect()
}

/// Share of a level that counts as being at it: the survey's bins are wider than a code.
const AT_LEVEL: f64 = 0.99;

/// Clipping is a matter of the stretch where it happens, and so is what happens at a time; the rest concerns all.
fn concerns(finding: &Finding, segment: &Segment) -> bool {
    let (from_s, to_s) = (segment.t0_s, segment.t_s(segment.len()));
    match finding {
        Finding::Clipping { channel, level, .. } => {
            let x = match channel {
                Channel::Voltage => &segment.v_v,
                Channel::Current => &segment.i_a,
            };
            x.iter().any(|x| x.abs() >= AT_LEVEL * level)
        }
        Finding::CarrierAbsent {
            from_s: a, to_s: b, ..
        } => *a < to_s && *b > from_s,
        _ => true,
    }
}
