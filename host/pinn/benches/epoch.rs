//! Time of full-batch epochs of the paper's two networks, all backends in one run: ratios count.
//! `cargo bench --profile full -p ihd-pinn --bench epoch`; against JAX: host/pinn/peers/epoch.py.

#[path = "../tests/it/truth.rs"]
mod truth;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ihd_pinn::{Backend, PinnConfig, Preset, identify};
use truth::Hob;

/// Epochs of one measurement: enough that setting up does not count.
const EPOCHS: usize = 10;

fn epochs(c: &mut Criterion) {
    // 1 MS/s, the first fifth of the paper's points: what does not fit the cache shows as well.
    let recording = Hob::at(45e3, 50.0).record_at(1e6);
    let mut group = c.benchmark_group(format!("{EPOCHS} epochs, paper's networks"));
    group.throughput(Throughput::Elements((EPOCHS * recording.v.len()) as u64));
    group.sample_size(10);
    for &backend in Backend::ALL {
        let mut config = PinnConfig {
            backend,
            max_iterations: EPOCHS,
            ..Preset::PaperRepaired.config()
        };
        if let Some(vi) = &mut config.vi_mlp {
            vi.downsampling = 1;
        }
        group.bench_function(backend.to_string(), |b| {
            b.iter(|| identify(&recording.waveform(), &config, &mut |_| {}));
        });
    }
    group.finish();
}

criterion_group!(benches, epochs);
criterion_main!(benches);
