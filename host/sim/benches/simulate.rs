//! Speed of the simulator: `cargo bench --profile full -p ihd-sim --bench simulate`.
//!
//! Targets: 20 ms of field model in at most 3 s, of behavioural model in at most 0.2 s,
//! one core, 20 ns steps, 16 rings x 44 depth nodes, sensing chain and truth included.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use ihd_field::model::FieldSettings;
use ihd_field::{FieldModel, harmonic};
use ihd_firmware::drive::bridge::Drive;
use ihd_sim::adc::{ConverterNoise, SimulatedAdc};
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_sim::recording::run::record;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};

fn recordings(c: &mut Criterion) {
    let mut group = c.benchmark_group("record 20 ms at 20 ns");
    group
        .sample_size(10)
        .measurement_time(Duration::from_secs(20));
    for load in [LoadKind::Field, LoadKind::Surrogate, LoadKind::Behavioural] {
        let settings = CaptureSpec {
            load,
            ..CaptureSpec::default()
        };
        group.bench_function(format!("{load:?}"), |b| {
            b.iter(|| record(black_box(&settings), |_| ()));
        });
    }
}

fn field_model(c: &mut Criterion) {
    let settings = FieldSettings::paper();
    c.bench_function("gap operator, 16 rings", |b| {
        b.iter(|| FieldModel::new(black_box(&settings)));
    });
    if let Ok(model) = FieldModel::new(&settings) {
        c.bench_function("describing function at 40 A", |b| {
            b.iter(|| harmonic::impedance(black_box(&model), 45e3, 40.0));
        });
    }
}

fn plant(c: &mut Criterion) {
    let mut group = c.benchmark_group("plant, one mains half-cycle at 45 kHz");
    group.sample_size(10);
    for load in [LoadKind::Field, LoadKind::Surrogate, LoadKind::Behavioural] {
        let adc = SimulatedAdc::new(ConverterNoise::default(), 1);
        let mut plant =
            Plant::with_load(SimulatedMains::new(50.0), PotKind::Ferromagnetic, load, adc);
        plant.set_drive(Drive::switching(45_000));
        group.bench_function(format!("{load:?}"), |b| {
            // 150 blocks of three periods are 10 ms.
            b.iter(|| {
                for _ in 0..150 {
                    black_box(plant.block(|_| ()));
                }
            });
        });
    }
}

/// Plant, firmware and link of an idle hob, which probes for a pot.
fn hob(c: &mut Criterion) {
    let mut group = c.benchmark_group("hob, 10 ms at the probe frequency");
    group.sample_size(10);
    for load in [LoadKind::Field, LoadKind::Behavioural] {
        let mut hob = SimHob::new(&HobConfig {
            load,
            ..HobConfig::default()
        });
        group.bench_function(format!("{load:?}"), |b| {
            b.iter(|| {
                let end_s = hob.t_s() + 10e-3;
                while hob.t_s() < end_s {
                    hob.step();
                }
            });
        });
    }
}

criterion_group!(benches, recordings, field_model, plant, hob);
criterion_main!(benches);
