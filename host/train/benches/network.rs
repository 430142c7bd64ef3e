//! Time of the network on one window of the device: `cargo bench --profile full -p ihd-train --features pinn --bench network`.

use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use ihd_pinn::{Backend, PinnConfig, Waveform, identify};
use ihd_shared::sampling::{ADC_LOCK_P, AMPERE_PER_CODE, Pair, VOLT_PER_CODE, f_adc_hz};

/// Switching frequency of the fixture, in hertz.
const F_SW_HZ: u32 = 45_000;

/// The fixture's pairs, whole blocks of them.
fn pairs() -> Vec<Pair> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fixtures/half_cycle/45k-snr30.pairs");
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (pairs, _) = bytes.as_chunks::<4>();
    let whole = pairs.len() - pairs.len() % ADC_LOCK_P;
    pairs[..whole]
        .iter()
        .map(|&b| Pair::from_le_bytes(b))
        .collect()
}

fn network(c: &mut Criterion) {
    let pairs = pairs();
    let v_volt: Vec<f64> = pairs
        .iter()
        .map(|p| f64::from(p.v) * VOLT_PER_CODE)
        .collect();
    let i_ampere: Vec<f64> = pairs
        .iter()
        .map(|p| f64::from(p.i) * AMPERE_PER_CODE)
        .collect();
    let waveform = Waveform {
        f_sw_hz: f64::from(F_SW_HZ),
        f_mains_hz: 50.0,
        t0_s: 0.0,
        dt_s: f_adc_hz(F_SW_HZ).recip(),
        v_volt: &v_volt,
        i_ampere: &i_ampere,
    };
    let run =
        |config: &PinnConfig| identify(&waveform, config, &mut |_| ()).expect("it identifies");
    let mut group = c.benchmark_group("network, one window");
    group.sample_size(10);
    for &backend in Backend::ALL {
        let cold = PinnConfig {
            backend,
            ..PinnConfig::default()
        };
        let found = run(&cold);
        let warm = PinnConfig {
            start: Some(found.parameters.clone()),
            ..cold.clone()
        };
        println!(
            "{backend}: {} steps cold, {} warm",
            found.iterations,
            run(&warm).iterations
        );
        for (name, config) in [("cold", &cold), ("warm", &warm)] {
            group.bench_function(format!("{backend}, {name}"), |b| b.iter(|| run(config)));
        }
    }
    group.finish();
}

criterion_group!(benches, network);
criterion_main!(benches);
