//! R lies within its stated deviation whatever the sensors are, corrected or not, or the result does not pass.

use ihd_gate::{Examination, ExamineOptions, Reconstruct, examine};
use ihd_identify::accuracy::fundamental;
use ihd_identify::{IdentifyOptions, Method};
use ihd_signal::Capture;
use ihd_sim::recording::settings::CaptureSpec;
use ihd_survey::Hints;
use ihd_survey::calibration::blind::BlindOptions;

mod simulated;

use simulated::{capture, clean};

/// A capture with changed settings, and least squares of it.
fn examined(change: impl Fn(&mut CaptureSpec)) -> (Capture, Examination) {
    let mut settings = clean();
    change(&mut settings);
    let capture = capture(&settings);
    let request = ExamineOptions {
        hints: Hints::default(),
        methods: &[Method::LeastSquares],
        sensors: BlindOptions::default(),
        settings: &IdentifyOptions::default(),
        reconstruct: Reconstruct::No,
    };
    let examined = examine(&capture, &request, &mut |_, _, _| ()).expect("a carrier");
    (capture, examined)
}

/// Errors of R as a root mean square over the half-cycles' middles: in standard deviations, and in percent.
fn errors(change: impl Fn(&mut CaptureSpec)) -> [f64; 2] {
    let (capture, examined) = examined(change);
    let truth = fundamental(&capture.truth);
    let found = examined.outcomes[0].result.as_ref().expect("an estimate");
    let segment = &examined.segments[0];
    let mut sums = [0.0; 3];
    for (k, t_s) in found.t_s.iter().enumerate() {
        let phase = segment.since_crossing_s(*t_s) / segment.half_cycle_s();
        let (Some((r_ohm, _)), true) = (truth.at(*t_s), (0.2..0.8).contains(&phase)) else {
            continue;
        };
        let off_ohm = found.r_ohm[k] - r_ohm;
        sums[0] += (off_ohm / found.r_sigma_ohm[k]).powi(2);
        sums[1] += (100.0 * off_ohm / r_ohm).powi(2);
        sums[2] += 1.0;
    }
    [0, 1].map(|k| (sums[k] / sums[2]).sqrt())
}

/// A lag that is too small to be corrected, or that a resistance of the bridge would explain, and one that ringing feigns.
#[test]
fn a_lag_that_is_not_corrected_is_in_the_deviation() {
    for (name, [sigmas, _]) in [
        ("droop", errors(|s| s.sensing.i_droop_hz = 30.0)),
        ("late", errors(|s| s.sensing.skew_s = 5e-9)),
        ("early", errors(|s| s.sensing.skew_s = -30e-9)),
        ("ringing", errors(|s| s.sensing.ringing = 0.3)),
    ] {
        assert!((0.3..3.0).contains(&sigmas), "{name}: {sigmas}");
    }
    let [sigmas, pct] = errors(|_| ());
    assert!(sigmas > 0.3 && pct < 0.02, "right ones: {sigmas}, {pct} %");
}

/// A skew over half a plateau might also be a slow voltage, of which R is another one; one of a microsecond leaves enough of it.
#[test]
fn what_leaves_r_uncertain_by_more_than_three_percent_does_not_pass() {
    let (_, examined) = examined(|s| s.sensing.skew_s = 3e-6);
    let outcome = &examined.outcomes[0];
    let found = outcome.result.as_ref().expect("an estimate");
    let sigmas = found.r_sigma_ohm.iter().zip(&found.r_ohm);
    let most = sigmas.map(|(sigma, r)| sigma / r).fold(0.0, f64::max);
    assert!(most > 0.03, "{most}");
    assert!(!outcome.judgement.gate.passes(), "{most}");
    let [sigmas, pct] = errors(|s| s.sensing.skew_s = 1e-6);
    assert!(sigmas < 3.0 && pct < 0.1, "{sigmas}, {pct} %");
}

/// A filter that both channels share bends what a skew is measured by; two unlike filters look like one with a skew.
#[test]
fn a_skew_beside_a_filter_is_taken_out() {
    for (f_sw_hz, skew_s, pole_hz, most_pct) in [
        (50e3, 30e-9, 300e3, 0.3),
        (45e3, 30e-9, 200e3, 0.3),
        // The tails hide all of the skew; a resistance of the bridge looks the same.
        (50e3, -30e-9, 300e3, 2.0),
    ] {
        let [sigmas, pct] = errors(|s| {
            (s.f_sw_hz, s.sensing.skew_s, s.sensing.pole_hz) = (f_sw_hz, skew_s, pole_hz);
        });
        let case = format!("{f_sw_hz} {skew_s} {pole_hz}: {sigmas}, {pct} %");
        assert!(sigmas < 3.0 && pct < most_pct, "{case}");
    }
    for (v_pole_hz, i_pole_hz) in [(200e3, 300e3), (300e3, 200e3)] {
        let [sigmas, pct] = errors(|s| {
            (s.sensing.v_pole_hz, s.sensing.i_pole_hz) = (v_pole_hz, i_pole_hz);
        });
        assert!(sigmas < 3.0 && pct < 4.0, "{v_pole_hz}: {sigmas}, {pct} %");
    }
}
