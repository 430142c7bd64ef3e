//! Which identified window may teach the lookup: the judge of `ihd identify`, and what a lookup asks beyond it.

use ihd_gate::{Evidence, Judgement, Witness};
use ihd_identify::network::append;
use ihd_identify::{Estimate, Method};
use ihd_pinn::Identified;
use ihd_signal::{Remark, Segment, Severity};

/// Findings that are warnings for who looks at a load, and errors for a lookup: its cells could not hold such values,
/// and the device would refuse it.
const ERRORS_FOR_A_LOOKUP: [&str; 2] = ["implausible_load", "not_covered"];

/// Judges an identified window.
///
/// `sensors`: what is to be said of the device's.
pub fn judge(segment: &Segment, identified: &Identified, sensors: &[Remark]) -> Judgement {
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    append(identified, segment.zero_crossing_s, &mut estimate);
    let judgement = ihd_gate::judge(&Evidence {
        remarks: sensors,
        segment,
        estimate: &estimate,
        witness: &Witness::of(segment),
    });
    let mut findings = judgement.findings;
    for finding in &mut findings {
        if ERRORS_FOR_A_LOOKUP.contains(&finding.code) {
            finding.severity = Severity::Error;
        }
    }
    Judgement::of(findings)
}
