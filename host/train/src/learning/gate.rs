//! Gate of the lookup: the judgement of `ihd identify` with two findings raised to errors.

use ihd_gate::{Evidence, Judgement, ReferenceResults};
use ihd_identify::network::append;
use ihd_identify::pooled::SharedSigma;
use ihd_identify::{Estimate, Method, Preprocessing};
use ihd_pinn::Identification;
use ihd_signal::{Remark, Segment, SegmentError, Severity};

/// Findings that are warnings in `ihd identify` and errors for a lookup: its cells cannot hold such values, and the device would refuse
/// it.
const ERRORS_FOR_A_LOOKUP: [&str; 2] = ["implausible_load", "not_covered"];

/// Judges an identified window with its preprocessing; `sensors` are the remarks on the device's sensors.
pub fn judge(
    segment: &Segment,
    preprocessing: &Result<Preprocessing, SegmentError>,
    identified: &Identification,
    sensors: &[Remark],
) -> Judgement {
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    append(identified, segment.zero_crossing_s, &mut estimate);
    let judgement = ihd_gate::judge(&Evidence {
        remarks: sensors,
        segment,
        estimate: &estimate,
        reference: &ReferenceResults::compute(segment, preprocessing, None),
        // The sensors' deviations are in the remarks and in the map.
        shared: SharedSigma::default(),
    });
    let mut findings = judgement.findings;
    for finding in &mut findings {
        if ERRORS_FOR_A_LOOKUP.contains(&finding.code) {
            finding.severity = Severity::Error;
        }
    }
    Judgement::from_findings(findings)
}
