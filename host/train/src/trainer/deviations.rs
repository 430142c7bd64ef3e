//! Deviations of a lookup's cells against its errors, for the loads of the simulated hob.

use ihd_link::Client;
use ihd_pinn::PinnConfig;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::transport::SharedHob;

use super::{RunOptions, TrainingSource, run};
use crate::lookup::{JudgedCell, judge_cells};

/// Cells of the lookup that `ihd trainer` teaches, beside their truth.
fn taught(load: LoadKind, seed: u64) -> Vec<JudgedCell> {
    let hob = SharedHob::new(
        SimHob::assemble(&HobConfig {
            load,
            seed,
            ..HobConfig::default()
        })
        .unwrap(),
    );
    let truth = hob.lock().map_truth(&mut |_| ()).unwrap();
    let client = Client::connect(Box::new(hob)).unwrap();
    let settings = RunOptions::new(
        TrainingSource::Powers(vec![1500, 2000, 1000, 700]),
        PinnConfig {
            deterministic: true,
            ..PinnConfig::default()
        },
    );
    let report = run(client, None, &settings, &mut |_| ()).unwrap();
    judge_cells(&report.built.expect("a lookup"), &truth)
}

/// Root mean squares of error over deviation, of R and of L.
fn z(cells: &[JudgedCell]) -> [f64; 2] {
    let rms = |of: fn(&JudgedCell) -> f64| {
        let squares: f64 = cells.iter().map(|c| of(c).powi(2)).sum();
        (squares / cells.len() as f64).sqrt()
    };
    [
        rms(|c| c.r_pct / c.r_sigma_pct),
        rms(|c| c.l_pct / c.l_sigma_pct),
    ]
}

fn assert_right(load: LoadKind, seed: u64) {
    let cells = taught(load, seed);
    let z = z(&cells);
    println!("{load:?}, seed {seed}: z {z:.2?}");
    assert!(cells.len() > 50);
    // One draw of errors that neighbouring cells share scatters by a third.
    assert!(
        z.iter().all(|z| (0.35..1.6).contains(z)),
        "{load:?} {seed}: {z:.2?}"
    );
}

/// A law that the map's physics does not have, at the converters' own noise.
#[test]
fn deviations_of_the_reference_load_are_those_of_its_errors() {
    assert_right(LoadKind::Behavioural, 1);
}

#[test]
fn deviations_are_those_of_the_errors_at_length() {
    for seed in 1..=5 {
        for load in [LoadKind::Behavioural, LoadKind::Surrogate] {
            assert_right(load, seed);
        }
    }
    assert_right(LoadKind::Field, 1);
}
