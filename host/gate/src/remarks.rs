//! Selection of the remarks that concern a segment, and their severity for a method.

use ihd_identify::Method;
use ihd_signal::{Remark, Segment, Severity};
use ihd_survey::aliasing::SEEN_AS_TONE_HZ;
use ihd_survey::{Channel, Finding, Survey};

/// Codes that matter only to methods that work sample by sample: phasors contain neither a mean nor signals between the
/// harmonics.
const TIME_DOMAIN_ONLY: [&str; 2] = ["coarsely_sampled", "offset"];

/// Code of a low signal-to-noise ratio. The ratio alone refuses nothing: the cost of noise is in σ and in the agreement with
/// the reference, both of which are judged.
const JUDGED_BY_SIGMA: &str = "noisy";

/// Largest share of R in percent that aliasing may cost. Its error lies on the fundamental itself and cannot be told from
/// the load by the samples.
const ALIASING_ERROR_PCT: f64 = 3.0;

/// Returns `true` if a method works with phasors.
fn works_with_phasors(method: Method) -> bool {
    matches!(
        method,
        Method::Lockin | Method::LeastSquares | Method::Pinn | Method::Firmware
    )
}

/// Returns a remark with its severity for a method.
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

/// Remarks on the survey's findings that concern a segment of the capture.
pub fn from_survey(survey: &Survey, segment: &Segment) -> Vec<Remark> {
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

/// Returns `true` if the finding is a prediction of something that [`crate::interference`] measures.
fn is_measured(finding: &Finding, segment: &Segment) -> bool {
    let Finding::Aliasing { order, .. } = finding else {
        return false;
    };
    let (f_hz, rate_hz) = (segment.f_sw_hz, 1.0 / segment.dt_s);
    let hz = f64::from(*order) * f_hz;
    let folded_hz = (hz - (hz / rate_hz).round() * rate_hz).abs();
    (folded_hz - f_hz).abs() > SEEN_AS_TONE_HZ
}

/// Share of a level from which a sample counts as clipped: the survey's bins are wider than a code.
const AT_LEVEL: f64 = 0.99;

/// Samples that are read at a time.
const STRETCH_SAMPLES: usize = 1 << 15;

/// Returns `true` if a finding concerns a segment. Clipping and missing carrier concern the segments where they happen, all
/// other findings every segment.
fn concerns(finding: &Finding, segment: &Segment) -> bool {
    let (from_s, to_s) = (segment.t0_s, segment.t_s(segment.len()));
    match finding {
        Finding::Clipping { channel, rails, .. } => {
            let (low, high) = rails.reached_from(AT_LEVEL);
            let x = match channel {
                Channel::Voltage => &segment.v_v,
                Channel::Current => &segment.i_a,
            };
            let mut buffer = Vec::new();
            let mut stretches = (0..x.len()).step_by(STRETCH_SAMPLES);
            stretches.any(|from| {
                let x = x.block(from..(from + STRETCH_SAMPLES).min(x.len()), &mut buffer);
                x.iter().any(|x| *x <= low || *x >= high)
            })
        }
        Finding::CarrierAbsent {
            from_s: a, to_s: b, ..
        } => *a < to_s && *b > from_s,
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use ihd_signal::Samples;
    use ihd_survey::clipping::Rails;

    use super::*;

    /// A current that clips at -85 A and at +75 A, in stretches of a capture.
    #[test]
    fn clipping_concerns_a_stretch_that_reaches_either_end() {
        let finding = Finding::Clipping {
            channel: Channel::Current,
            samples: 100,
            level: 85.0,
            rails: Rails {
                low: Some(-85.0),
                high: Some(75.0),
            },
        };
        let concerned = |crests: [f32; 2]| {
            let segment = Segment {
                f_sw_hz: 45e3,
                mains_hz: 50.0,
                zero_crossing_s: 0.0,
                t0_s: 0.0,
                dt_s: 1e-7,
                v_v: Samples::singles(vec![0.0; 2]),
                i_a: Samples::singles(crests.to_vec()),
            };
            concerns(&finding, &segment)
        };
        assert!(concerned([75.0, -60.0]) && concerned([60.0, -85.0]));
        assert!(!concerned([74.0, -84.0]));
    }
}
