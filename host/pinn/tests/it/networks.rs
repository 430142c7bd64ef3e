//! The paper's two networks: training, limits, checkpoints, backends.

use std::path::Path;

use crate::truth::{Hob, Recording};
use ihd_pinn::{
    Backend, Identification, IdentifyTask, PinnConfig, Preset, StopReason, ViMlp, identify,
};

fn recording() -> Recording {
    Hob::at(45e3, 50.0).record()
}

/// Small networks on few points, for tests of the training itself.
fn small() -> PinnConfig {
    PinnConfig {
        vi_mlp: Some(ViMlp {
            hidden_layers: vec![24, 24],
            downsampling: 5,
            ..ViMlp::default()
        }),
        learning_rate: 3e-3,
        max_iterations: 150,
        ..Preset::PaperRepaired.config()
    }
}

fn trained(config: &PinnConfig) -> Identification {
    identify(&recording().waveform(), config, &mut |_| {}).expect("a sound window")
}

fn resumed(config: &PinnConfig, checkpoint: &Path) -> Result<Identification, ihd_pinn::PinnError> {
    let recording = recording();
    let task = IdentifyTask {
        window: recording.waveform(),
        config,
        truth: None,
        checkpoint: Some(checkpoint),
    };
    task.run(&mut |_| {})
}

#[test]
fn the_loss_falls_and_the_best_parameters_are_the_result() {
    let found = trained(&small());
    assert_eq!(found.stopped_because, StopReason::IterationLimit);
    assert_eq!(found.history.len(), 150);
    let first = found.history[0].loss;
    let least = found
        .history
        .iter()
        .map(|p| p.loss)
        .fold(f64::INFINITY, f64::min);
    assert!(least < 0.2 * first, "{first} {least}");
    assert!((found.losses.total / least - 1.0).abs() < 1e-4);
    let eq_7 = 5.0 * found.losses.l_f + found.losses.l_i1 + found.losses.l_i2;
    assert!((found.losses.total / eq_7 - 1.0).abs() < 1e-6);
    assert_eq!(
        found.reconstruction.waveforms().sample.len(),
        recording().v.len().div_ceil(5)
    );
}

#[test]
fn ndarray_and_the_fused_kernel_walk_one_loss_curve() {
    let curve = |backend| {
        let config = PinnConfig {
            backend,
            max_iterations: 12,
            ..small()
        };
        trained(&config).history
    };
    let fused = curve(Backend::Fused);
    let backend = Backend::Ndarray;
    for (a, b) in fused.iter().zip(curve(backend)) {
        // Single precision, and Adam divides by the gradient's own size.
        assert!(
            (a.loss / b.loss - 1.0).abs() < 2e-3,
            "{backend}: {a:?} {b:?}"
        );
    }
}

#[test]
fn a_training_that_was_stopped_goes_on_exactly() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("training.bpk");
    for minibatch in [None, Some(500)] {
        let mut config = small();
        config.vi_mlp.as_mut().expect("has one").minibatch = minibatch;
        let whole = trained(&config);
        let half = PinnConfig {
            max_iterations: 77,
            ..config.clone()
        };
        let first = resumed(&half, &path).expect("trains");
        let found = resumed(&config, &path).expect("goes on");
        assert_eq!(found.parameters, whole.parameters);
        let losses =
            |found: &Identification| -> Vec<f64> { found.history.iter().map(|p| p.loss).collect() };
        assert_eq!(losses(&found), losses(&whole));
        // Both sittings count, and the clock never runs back.
        let earlier_s = first.history.last().map_or(0.0, |p| p.elapsed_s);
        assert!(found.elapsed_s > earlier_s && earlier_s > 0.0);
        let mut times = found.history.windows(2);
        assert!(times.all(|p| p[0].elapsed_s <= p[1].elapsed_s));
        std::fs::remove_file(&path).expect("was written");
    }
}

#[test]
fn a_checkpoint_of_another_training_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("training.bpk");
    let config = PinnConfig {
        max_iterations: 3,
        ..small()
    };
    resumed(&config, &path).expect("trains");
    let other = PinnConfig { seed: 2, ..config };
    let error = resumed(&other, &path).expect_err("another seed");
    assert!(
        error
            .to_string()
            .contains("another window or configuration"),
        "{error}"
    );
    std::fs::write(&path, b"no burnpack").expect("writable");
    assert!(resumed(&other, &path).is_err());
}

#[test]
fn a_loss_that_is_not_finite_is_rolled_back() {
    let config = PinnConfig {
        learning_rate: 1e300,
        ..small()
    };
    let found = trained(&config);
    assert_eq!(found.stopped_because, StopReason::RolledBack);
    assert!(found.losses.total.is_finite() && found.r_ohm.iter().all(|r| r.is_finite()));
}

#[test]
fn limits_on_time_hold_unless_the_run_must_be_deterministic() {
    let limited = PinnConfig {
        time_limit_s: 1e-9,
        max_iterations: 5,
        ..small()
    };
    assert_eq!(trained(&limited).stopped_because, StopReason::TimeLimit);
    let deterministic = PinnConfig {
        deterministic: true,
        ..limited
    };
    let found = trained(&deterministic);
    assert_eq!(found.stopped_because, StopReason::IterationLimit);
    assert_eq!(found.parameters, trained(&deterministic).parameters);
}

#[test]
fn progress_carries_the_errors_where_the_truth_is_known() {
    let (recording, config) = (
        recording(),
        PinnConfig {
            max_iterations: 12,
            ..small()
        },
    );
    let hob = recording.hob;
    let truth = |t_s: f64| (hob.r_ohm(t_s), hob.l_h(t_s));
    let task = IdentifyTask {
        window: recording.waveform(),
        config: &config,
        truth: Some(&truth),
        checkpoint: None,
    };
    let mut seen = Vec::new();
    let found = task.run(&mut |p| seen.push(p.mre_pct)).expect("trains");
    assert_eq!(seen.len(), 12);
    // Against the errors at the end, computed from the result: R and L hardly move in one epoch.
    let mre = |of: fn(&Identification, f64) -> f64, true_at: &dyn Fn(f64) -> f64| {
        let at = |t: &f64| (of(&found, *t) / true_at(*t) - 1.0).abs();
        100.0 * found.t_s.iter().map(at).sum::<f64>() / found.t_s.len() as f64
    };
    let (r, l) = seen[11].expect("the truth is known");
    assert!((r - mre(Identification::r_at, &|t| hob.r_ohm(t))).abs() < 0.1 * r);
    assert!((l - mre(Identification::l_at, &|t| hob.l_h(t))).abs() < 0.1 * l);
}

#[test]
fn an_ensemble_gives_a_spread_and_loss_balancing_moves_the_weight() {
    let config = PinnConfig {
        ensemble: 3,
        max_iterations: 10,
        ..small()
    };
    let found = trained(&config);
    assert_eq!(found.r_sigma_ohm.len(), found.r_ohm.len());
    assert!(found.r_sigma_ohm.iter().all(|s| *s > 0.0));
    let mut balanced = small();
    balanced.vi_mlp.as_mut().expect("has one").balance_every = 10;
    assert_ne!(trained(&balanced).parameters, trained(&small()).parameters);
}

/// With hardly a physics term at first, balancing multiplies the loss: the parameters before it are none of a balanced training.
#[test]
fn the_best_parameters_are_those_since_the_weight_moved() {
    let mut config = PinnConfig {
        w_f: 1e-6,
        ..small()
    };
    config.vi_mlp.as_mut().expect("has one").balance_every = 149;
    let found = trained(&config);
    let last = found.history[149];
    assert!((found.losses.l_f / last.l_f - 1.0).abs() < 1e-4);
    let l_i = found.losses.l_i1 + found.losses.l_i2;
    assert!((l_i / last.l_i - 1.0).abs() < 1e-4);
    // Members of an ensemble are compared at the configured weights, as the history is.
    assert!((found.losses.total / last.loss - 1.0).abs() < 1e-4);
}

#[test]
fn a_warm_start_goes_on_from_its_weights() {
    let cold = trained(&small());
    let config = PinnConfig {
        start: Some(cold.parameters.clone()),
        ..small()
    };
    let warm = trained(&config);
    assert!(warm.history[0].loss < 0.5 * cold.history[0].loss);
}
