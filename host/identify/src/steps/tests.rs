use ihd_signal::Segment;
use ihd_signal::noise::{WhiteNoise, mean_square};
use ihd_sim::recording::run::{SimulatedRecording, record};
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{
    CaptureSpec as Recorded, LoadKind, RecordingChange, RecordingEvent,
};

use super::*;
use crate::{Preprocessing, ProgressSink, accuracy, run, run_preprocessed};

/// A half-cycle of the behavioural load at 50 kHz, whose R and L become these times the law's at these times in seconds.
fn recorded(
    steps: &[(f64, f64, f64)],
    rate_hz: f64,
    snr_db: Option<f64>,
) -> (SimulatedRecording, Segment) {
    let mut settings = Recorded {
        f_sw_hz: 50e3,
        load: LoadKind::Behavioural,
        duration_s: 10e-3,
        ..Recorded::default()
    };
    settings.sensing.rate = Rate::Hz(rate_hz);
    settings.sensing.allow_aliasing = true;
    settings.sensing.snr_db = snr_db;
    let event = |&(t_s, r_factor, l_factor): &(f64, f64, f64)| RecordingEvent {
        t_s,
        change: RecordingChange::Load { r_factor, l_factor },
    };
    settings.events = steps.iter().map(event).collect();
    let recording = record(&settings, |_| ()).unwrap();
    let capture = recording.capture("steps");
    let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect();
    let (v_v, i_a) = (wide(&capture.v_v), wide(&capture.i_a));
    let segment = recording.clean_segment().with_samples(v_v, i_a);
    (recording, segment)
}

const LIFTED: [(f64, f64, f64); 1] = [(5e-3, 0.6, 1.35)];
const SPOON: [(f64, f64, f64); 2] = [(5e-3, 3.0, 1.0), (5.3e-3, 1.0, 1.0)];

fn steps(segment: &Segment) -> Vec<Step> {
    Steps::detect(segment, HannFrames::compute(segment).as_ref()).0
}

#[test]
fn steps_are_found_where_they_are_and_with_their_sizes() {
    for (rate_hz, snr_db) in [(11.37e6, None), (11.37e6, Some(20.0)), (2.57e6, Some(30.0))] {
        let found = steps(&recorded(&LIFTED, rate_hz, snr_db).1);
        assert_eq!(found.len(), 1, "{found:?}");
        let step = found[0];
        assert!((step.t_s - 5e-3).abs() < 20e-6, "{step:?}");
        // The current rises, and R and L follow it by nature.
        let times = step.r_ohm.1 / step.r_ohm.0;
        assert!((0.5..0.75).contains(&times), "{step:?}");
        let times = step.l_h.1 / step.l_h.0;
        assert!((1.2..1.55).contains(&times), "{step:?}");
        let found = steps(&recorded(&SPOON, rate_hz, snr_db).1);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0].t_s - 5.0e-3).abs() < 20e-6, "{found:?}");
        assert!((found[1].t_s - 5.3e-3).abs() < 20e-6, "{found:?}");
    }
}

#[test]
fn a_load_that_does_not_step_shows_no_step() {
    for (rate_hz, snr_db) in [
        (11.37e6, None),
        (11.37e6, Some(20.0)),
        (1.03e6, Some(20.0)),
        (2.57e6, Some(30.0)),
    ] {
        let found = steps(&recorded(&[], rate_hz, snr_db).1);
        assert!(found.is_empty(), "{rate_hz} {snr_db:?}: {found:?}");
    }
}

#[test]
fn the_pieces_are_identified_and_joined_in_order_of_time() {
    for steps in [&LIFTED[..], &SPOON[..]] {
        let (recording, segment) = recorded(steps, 11.37e6, Some(50.0));
        for method in [Method::LeastSquares, Method::Lockin] {
            let estimate = run(method, &segment, &IdentifyOptions::default()).unwrap();
            assert!(estimate.t_s.windows(2).all(|t| t[0] < t[1]));
            let said = estimate.remarks.iter().filter(|r| r.code == "load_step");
            assert_eq!(said.count(), steps.len());
            let found =
                accuracy::Accuracy::measure(&estimate, &segment, &recording.truth, 0.0).unwrap();
            // The truth itself takes two periods for a step: half of each is a quarter of a percent of the half-cycle.
            assert!(
                found.middle.r_pct < 0.4 && found.middle.l_pct < 0.2,
                "{method}: {found:?}"
            );
        }
        let whole = run(Method::Rls, &segment, &IdentifyOptions::default()).unwrap();
        let warns = |r: &Remark| r.code == "load_step" && r.severity == Severity::Warning;
        assert!(whole.remarks.iter().any(warns));
    }
}

/// The piece between the steps has eleven periods, too few to measure noise. That of the whole segment then limits what n samples of it
/// can say of R: σ of a phasor's component is √(2/n) of a sample's.
#[test]
fn a_piece_without_noise_of_its_own_has_that_of_the_segment() {
    let (_, segment) = recorded(&SPOON, 11.37e6, None);
    let noise = WhiteNoise {
        v_v: 100.0,
        i_a: 20.0,
    };
    let preprocessing = Preprocessing::with_noise(&segment, Some(noise)).unwrap();
    let piece = segment.part(segment.index_at(5.0e-3), segment.index_at(5.3e-3));
    let [v_square, i_square] = [&piece.v_v, &piece.i_a].map(|x| mean_square(x));
    let white = noise.v_v.powi(2) + v_square / i_square * noise.i_a.powi(2);
    let least_ohm = (2.0 * white / piece.len() as f64 / (2.0 * i_square)).sqrt();
    for method in [Method::LeastSquares, Method::Lockin] {
        let (truth, report) = (None, &mut |_| {});
        let mut sink = ProgressSink { truth, report };
        let settings = IdentifyOptions::default();
        let estimate =
            run_preprocessed(method, &segment, &preprocessing, None, &settings, &mut sink).unwrap();
        let all = estimate.t_s.iter().zip(&estimate.r_sigma_ohm);
        let inner: Vec<f64> = all
            .filter(|(t_s, _)| (5.08e-3..5.22e-3).contains(*t_s))
            .map(|(_, sigma)| *sigma)
            .collect();
        // The voltage's harmonics are a fifth of its square, and in |Z|² here.
        assert!(
            !inner.is_empty() && inner.iter().all(|sigma| *sigma > 0.8 * least_ohm),
            "{method}: {inner:?} {least_ohm}"
        );
    }
}
