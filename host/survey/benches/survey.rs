//! Speed of the survey: `cargo bench --profile full -p ihd-survey --bench survey`.
//!
//! A million samples in 0.3 s is the aim. One real FFT of all samples of a channel, the least that a
//! search by one transform would take, is the peer in the same run.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ihd_signal::Capture;
use ihd_sim::recording::run::record;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use ihd_survey::{Hints, Survey};

/// 20 ms at 50 MS/s, 30 dB.
fn capture() -> Capture {
    let mut settings = CaptureSpec {
        load: LoadKind::Behavioural,
        ..CaptureSpec::default()
    };
    settings.sensing.snr_db = Some(30.0);
    let recording = record(&settings, |_| ()).expect("the simulator records");
    let mut capture = recording.capture("bench");
    capture.f_sw.clear();
    (capture.mains_hz, capture.zero_crossing_s) = (None, None);
    capture
}

fn survey(c: &mut Criterion) {
    let capture = capture();
    let mut group = c.benchmark_group(format!("{} samples", capture.len()));
    group
        .sample_size(20)
        .throughput(Throughput::Elements(capture.len() as u64));
    group.bench_function("survey", |b| {
        b.iter(|| Survey::from_capture(black_box(&capture), &Hints::default()));
    });
    let fft = ihd_signal::fourier::forward(capture.len());
    let x: Vec<f64> = capture.v_v.iter().map(|v| f64::from(*v)).collect();
    let (mut input, mut output) = (fft.make_input_vec(), fft.make_output_vec());
    group.bench_function("peer: one FFT of one channel", |b| {
        b.iter(|| {
            input.copy_from_slice(black_box(&x));
            fft.process(&mut input, &mut output)
        });
    });
    group.finish();
}

criterion_group!(benches, survey);
criterion_main!(benches);
