//! Exchanged channels and reversed probes: an impedance that falls with frequency, or a negative L, is no coil's.

use std::borrow::Cow;

use ihd_signal::{Capture, Remark, Severity};
use ihd_survey::{Finding, Survey};

/// Exchanges the channels or reverses the current if the survey says so. What contradicts the user's own exchange stays an error.
pub(super) fn repair(capture: &mut Cow<'_, Capture>, survey: &Survey) -> Option<Remark> {
    let by_user = |f: &Finding| {
        matches!(
            f,
            Finding::Swapped { by_user: true }
                | Finding::Inverted { by_user: true, .. }
                | Finding::Dead { .. }
        )
    };
    let wiring = survey.wiring;
    if !(wiring.swapped || wiring.inverted) || survey.findings.iter().any(by_user) {
        return None;
    }
    let capture = capture.to_mut();
    if wiring.swapped {
        std::mem::swap(&mut capture.v_v, &mut capture.i_a);
        std::mem::swap(&mut capture.v_full_scale_v, &mut capture.i_full_scale_a);
    }
    if wiring.inverted {
        capture.i_a.iter_mut().for_each(|i| *i = -*i);
    }
    let text = match (wiring.swapped, wiring.inverted) {
        (true, false) => {
            "voltage and current were exchanged (the impedance falls with frequency): they are taken the other way round; \
             --input swap confirms it"
        }
        (true, true) => {
            "voltage and current were exchanged and one probe reversed: both are put right; --input swap,invert=i confirms it"
        }
        _ => {
            "one probe was the wrong way round (R and L negative): its sign is changed; --input invert=i confirms it"
        }
    };
    Some(match wiring.swapped {
        true => Remark::new("swapped", Severity::Warning, text),
        false => Remark::new("inverted", Severity::Warning, text),
    })
}
