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

/// Share of R in percent that aliasing may cost at most. What it costs lies on the fundamental itself, and nothing in
/// the samples tells it from the load.
const ALIASING_ERROR_PCT: f64 = 3.0;

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
    let costly = remark.value.is_some_and(|pct| pct > ALIASING_ERROR_PCT);
    if remark.code == "aliasing" && remark.severity == Severity::Warning && costly {
        remark.severity = Severity::Error;
    }
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
        .map(|finding| {
            let mut remark = finding.remark();
            if is_measured(finding, segment) {
                remark.severity = Severity::Info;
            }
            remark
        })
        .collect()
}

/// Offset in hertz from which on an alias beside the carrier is seen as a tone, and what it costs is measured.
const SEEN_AS_TONE_HZ: f64 = 300.0;

/// Whether the finding is an expectation that the gate measures.
fn is_measured(finding: &Finding, segment: &Segment) -> bool {
    let Finding::Aliasing { order, .. } = finding else {
        return false;
    };
    let (f_hz, rate_hz) = (segment.f_sw_hz, 1.0 / segment.dt_s);
    let hz = f64::from(*order) * f_hz;
    let folded_hz = (hz - (hz / rate_hz).round() * rate_hz).abs();
    (folded_hz - f_hz).abs() > SEEN_AS_TONE_HZ
}

/// Share of a level that counts as being at it: the survey's bins are wider than a code.
const AT_LEVEL: f64 = 0.99;

/// Samples that are looked at together.
const STRETCH: usize = 1 << 15;

/// Clipping is a matter of the stretch where it happens, and so is what happens at a time; the rest concerns all.
fn concerns(finding: &Finding, segment: &Segment) -> bool {
    let (from_s, to_s) = (segment.t0_s, segment.t_s(segment.len()));
    match finding {
        Finding::Clipping { channel, level, .. } => {
            let x = match channel {
                Channel::Voltage => &segment.v_v,
                Channel::Current => &segment.i_a,
            };
            let mut buffer = Vec::new();
            let mut stretches = (0..x.len()).step_by(STRETCH);
            stretches.any(|from| {
                let x = x.block(from..(from + STRETCH).min(x.len()), &mut buffer);
                x.iter().any(|x| x.abs() >= AT_LEVEL * level)
            })
        }
        Finding::CarrierAbsent {
            from_s: a, to_s: b, ..
        } => *a < to_s && *b > from_s,
        _ => true,
    }
}
