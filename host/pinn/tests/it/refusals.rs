//! Errors of `identify`: each says what is wrong, where, and what to do.

use crate::truth::{Hob, Recording};
use ihd_pinn::{Backend, Optimiser, PinnConfig, PinnError, Waveform, identify};

fn recording() -> Recording {
    Hob::at(45e3, 50.0).record()
}

fn refused(window: &Waveform<'_>, config: &PinnConfig) -> PinnError {
    identify(window, config, &mut |_| {}).expect_err("must be refused")
}

fn refused_window(change: impl FnOnce(&mut Waveform<'_>)) -> PinnError {
    let recording = recording();
    let mut window = recording.waveform();
    change(&mut window);
    refused(&window, &PinnConfig::default())
}

fn refused_config(change: impl FnOnce(&mut PinnConfig)) -> PinnError {
    let mut config = PinnConfig::default();
    change(&mut config);
    refused(&recording().waveform(), &config)
}

#[test]
fn channels_of_different_length() {
    let error = refused_window(|w| w.v_volt = &w.v_volt[1..]);
    assert!(matches!(error, PinnError::LengthMismatch { v, i } if v + 1 == i));
}

#[test]
fn windows_too_short_for_the_unknowns() {
    for pairs in [0, 1, 10, 100] {
        let error = refused_window(|w| {
            w.v_volt = &w.v_volt[..pairs];
            w.i_ampere = &w.i_ampere[..pairs];
        });
        // The very first pairs are zero: no signal is as true as too short.
        assert!(
            matches!(
                error,
                PinnError::TooShort { .. } | PinnError::NoSignal { .. }
            ),
            "{pairs} pairs: {error}"
        );
    }
}

#[test]
fn samples_that_are_not_numbers_by_channel_and_index() {
    let mut recording = recording();
    recording.v[1234] = f64::NAN;
    let error = refused(&recording.waveform(), &PinnConfig::default());
    assert!(
        error.to_string().contains("voltage sample 1234 is NaN"),
        "{error}"
    );
    recording.v[1234] = 0.0;
    recording.i[99] = f64::NEG_INFINITY;
    let error = refused(&recording.waveform(), &PinnConfig::default());
    assert!(
        error.to_string().contains("current sample 99 is -inf"),
        "{error}"
    );
}

#[test]
fn times_and_frequencies_that_are_not_positive() {
    for bad in [0.0, -45e3, f64::NAN, f64::INFINITY] {
        for error in [
            refused_window(|w| w.f_sw_hz = bad),
            refused_window(|w| w.f_mains_hz = bad),
            refused_window(|w| w.dt_s = bad),
        ] {
            assert!(matches!(error, PinnError::NotPositive { .. }), "{error}");
        }
    }
}

#[test]
fn a_channel_without_signal() {
    let mut recording = recording();
    recording.i.fill(0.0);
    let error = refused(&recording.waveform(), &PinnConfig::default());
    assert_eq!(error, PinnError::NoSignal { channel: "current" });
}

#[test]
fn sampling_that_cannot_separate_the_harmonics() {
    let error = refused_config(|c| c.harmonics = vec![1, 3, 5, 7, 9, 11]);
    assert!(matches!(
        error,
        PinnError::SamplingTooSlow { harmonic: 11, .. }
    ));
    let error = refused_window(|w| w.f_sw_hz = 100e3);
    assert!(matches!(
        error,
        PinnError::SamplingTooSlow { harmonic: 7, .. }
    ));
}

#[test]
fn windows_over_a_zero_crossing() {
    for t0_s in [1e-3, -1e-3, f64::NAN] {
        let error = refused_window(|w| w.t0_s = t0_s);
        assert!(
            matches!(error, PinnError::SpansZeroCrossing { .. }),
            "{t0_s}"
        );
    }
    // Half a per cent of the half-cycle either way is a mains frequency that drifts.
    let recording = recording();
    let mut window = recording.waveform();
    window.t0_s = 5e-5;
    assert!(identify(&window, &PinnConfig::default(), &mut |_| {}).is_ok());
}

#[test]
fn settings_out_of_range_by_name() {
    type Change = fn(&mut PinnConfig);
    let changes: [(&str, Change); 14] = [
        ("harmonics", |c| c.harmonics = vec![3, 5]),
        ("harmonics", |c| c.harmonics = vec![1, 5, 3]),
        ("physics_harmonics", |c| c.physics_harmonics = vec![9]),
        ("physics_harmonics", |c| c.physics_harmonics.clear()),
        ("spline_intervals", |c| c.spline_intervals = 3),
        ("slow_points", |c| c.slow_points = 0),
        ("hidden_layers", |c| c.hidden_layers.clear()),
        ("hidden_layers", |c| c.hidden_layers[0] = 0),
        ("outer_passes", |c| c.outer_passes = 0),
        ("max_iterations", |c| c.max_iterations = 0),
        ("w_f", |c| c.w_f = -1.0),
        ("l_scale_h", |c| c.l_scale_h = f64::NAN),
        ("weight_width", |c| c.weight_width = -1.0),
        ("time_limit_s", |c| c.time_limit_s = 0.0),
    ];
    for (name, change) in changes {
        match refused_config(change) {
            PinnError::Config { field, .. } => assert!(field.starts_with(name), "{field}"),
            other => panic!("{name}: {other}"),
        }
    }
}

#[test]
fn a_spline_that_no_window_can_carry() {
    let error = refused_config(|c| c.spline_intervals = 400);
    assert!(matches!(error, PinnError::TooShort { .. }), "{error}");
}

#[test]
fn a_warm_start_of_another_shape_or_with_damage() {
    let recording = recording();
    let found =
        identify(&recording.waveform(), &PinnConfig::default(), &mut |_| {}).expect("sound");
    let mut config = PinnConfig {
        start: Some(found.parameters),
        hidden_layers: vec![16],
        ..PinnConfig::default()
    };
    let error = refused(&recording.waveform(), &config);
    assert!(error.to_string().contains("[6, 6]"), "{error}");
    config.hidden_layers = vec![6, 6];
    if let Some(start) = &mut config.start {
        start.layers[1].weights[3] = f64::NAN;
    }
    let error = refused(&recording.waveform(), &config);
    assert!(error.to_string().contains("damaged"), "{error}");
}

#[test]
fn names_are_read_back_as_written_and_others_listed() {
    for &backend in Backend::ALL {
        assert_eq!(backend.to_string().parse(), Ok(backend));
    }
    for optimiser in [Optimiser::LevenbergMarquardt, Optimiser::Adam] {
        assert_eq!(optimiser.to_string().parse(), Ok(optimiser));
    }
    let error = "tpu".parse::<Backend>().expect_err("no such backend");
    assert_eq!(
        error.to_string(),
        r#"unknown backend "tpu"; known: fused, ndarray (wgpu in builds with this feature)"#
    );
    assert!("sgd".parse::<Optimiser>().is_err());
}
