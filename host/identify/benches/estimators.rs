//! Speed of the host's estimators: `cargo bench --profile full -p ihd-identify --bench estimators`.
//!
//! Input: one mains cycle of the behavioural reference load at 45 kHz, 50 MS/s, noise of 30 dB:
//! 1 000 000 samples, as in the paper, whose EKF took 13.2 s in MATLAB for as many.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ihd_identify::ekf::step::{EnvelopeFilter, Model};
use ihd_identify::ekf::{PreparedSegment, rts};
use ihd_identify::lockin::{Boxcar, Lockin};
use ihd_identify::{IdentifyOptions, Method, run};
use ihd_signal::Segment;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec as SimSettings, LoadKind};
use ihd_sim::trial::Trial;
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

fn capture(rate: Rate) -> Segment {
    let settings = SimSettings {
        load: LoadKind::Behavioural,
        sensing: Sensing {
            rate,
            ..Sensing::default()
        },
        ..SimSettings::default()
    };
    let trial = Trial::record(&settings).expect("the preset simulates");
    trial.noisy(Some(30.0), 1)
}

/// One pass of the structured filter.
fn pass(prepared: &PreparedSegment) -> EnvelopeFilter {
    let mut filter = prepared.start;
    for (i, v) in prepared.i.iter().zip(&prepared.v) {
        filter.step(&prepared.model, *i, *v);
    }
    filter
}

/// The same filter as dense 4×4 products, for the ratio.
fn dense_pass(prepared: &PreparedSegment) -> Vector4<f64> {
    let m: &Model = &prepared.model;
    let mut f = Matrix4::identity();
    f[(0, 1)] = m.f12;
    let q = Matrix4::from_diagonal(&Vector4::from(m.q));
    let r = Matrix2::from_diagonal(&Vector2::from(m.r));
    let [a, b, c, d, e, g, h, k, l, n] = prepared.start.p;
    let mut p = Matrix4::new(a, b, c, d, b, e, g, h, c, g, k, l, d, h, l, n);
    let mut x = Vector4::from(prepared.start.x);
    for (i, v) in prepared.i.iter().zip(&prepared.v) {
        x = f * x;
        p = f * p * f.transpose() + q;
        let h = Matrix2x4::new(1.0, 0.0, 0.0, 0.0, x[2], x[3], x[0], x[1]);
        let s = h * p * h.transpose() + r;
        let gain = p * h.transpose() * s.try_inverse().expect("S is at least R");
        x += gain * (Vector2::new(*i, *v) - Vector2::new(x[0], x[0] * x[2] + x[1] * x[3]));
        p = (Matrix4::identity() - gain * h) * p;
    }
    x
}

fn ekf(c: &mut Criterion) {
    let segment = capture(Rate::Hz(50e6));
    let prepared = PreparedSegment::new(&segment, &IdentifyOptions::default());
    let mut group = c.benchmark_group("four-state EKF, 1 000 000 samples");
    group.sample_size(10);
    group.throughput(Throughput::Elements(segment.len() as u64));
    group.bench_function("structured", |b| b.iter(|| pass(black_box(&prepared))));
    group.bench_function("dense 4x4", |b| b.iter(|| dense_pass(black_box(&prepared))));
    group.bench_function("smoother, forward and backward", |b| {
        b.iter(|| {
            let mut sum = 0.0;
            let (model, start) = (&prepared.model, prepared.start);
            rts::smooth(model, start, &prepared.i, &prepared.v, |_, x, _| {
                sum += x[2]
            });
            sum
        });
    });
    group.finish();
}

fn lockin(c: &mut Criterion) {
    let segment = capture(Rate::Hz(50e6));
    let boxcar = Boxcar::fitting(segment.samples_per_period(), segment.f_sw_hz, 0.1e-3);
    let mut group = c.benchmark_group("lock-in, streaming");
    group.sample_size(20);
    group.throughput(Throughput::Elements(segment.len() as u64));
    group.bench_function("sample pairs at 50 MS/s", |b| {
        b.iter(|| {
            let mut lockin = Lockin::new(&segment, boxcar);
            let v = segment.v_v.chunks_exact(boxcar.block);
            let blocks = v.zip(segment.i_a.chunks_exact(boxcar.block));
            blocks.filter_map(|(v, i)| lockin.push(v, i)).count()
        });
    });
    group.finish();
}

fn half_cycle(c: &mut Criterion) {
    let settings = IdentifyOptions::default();
    let mut group = c.benchmark_group("one half-cycle");
    group.sample_size(20);
    for (name, rate) in [("50 MS/s", Rate::Hz(50e6)), ("f_sw·61/3", Rate::Locked)] {
        let whole = capture(rate);
        let second = whole.part(whole.len() / 2, whole.len());
        group.throughput(Throughput::Elements(second.len() as u64));
        for method in [
            Method::LeastSquares,
            Method::Lockin,
            Method::Rls,
            Method::Firmware,
        ] {
            group.bench_function(format!("{method}, {name}"), |b| {
                b.iter(|| run(method, black_box(&second), &settings).expect("it identifies"));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, ekf, lockin, half_cycle);
criterion_main!(benches);
