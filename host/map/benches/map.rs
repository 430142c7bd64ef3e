//! Speed of the map: `cargo bench --profile full -p ihd-map`. Target: the fit of a pot that was never seen within 50 ms of one core.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use ihd_map::library::{Library, MAX_ENTRIES};
use ihd_map::{CurrentCurve, MeasuredPoint, PotEntry, PotMap, PotModel, Provenance};

/// A curve of a ferritic pot of 18 cm, with the errors of a window at 40 dB.
fn curve(f_hz: f64, most_a: f64, t_s: f64) -> CurrentCurve {
    let pot = PotModel {
        radius_m: 0.09,
        winding_r_ohm: 0.1,
        ..PotModel::PAPER
    };
    let mut at = pot.at_frequency(f_hz);
    let points: Vec<_> = (0..400)
        .map(|k| {
            let i_a = most_a * (f64::from(k) + 0.5) / 400.0;
            let z = at.impedance(i_a);
            let sigma = 5e-3 * most_a / i_a;
            // What a describing function leaves, instead of noise.
            let off = 1.0 + 3e-3 * (6.0 * i_a / most_a).sin();
            MeasuredPoint {
                i_a,
                r_ohm: z.r_ohm * off,
                l_h: z.l_h / off,
                r_sigma_ohm: sigma * z.r_ohm,
                l_sigma_h: sigma * z.l_h,
            }
        })
        .collect();
    CurrentCurve::new(f_hz, t_s, points.into_iter())
}

fn bench(c: &mut Criterion) {
    let curves = [
        (63e3, 26.0),
        (55e3, 33.0),
        (52e3, 37.0),
        (48e3, 44.0),
        (45e3, 52.0),
    ]
    .map(|(f_hz, most_a)| curve(f_hz, most_a, 0.0));
    c.bench_function("impedance, a rising current", |b| {
        let mut at = PotModel::PAPER.at_frequency(45e3);
        b.iter(|| {
            let mut sum = 0.0;
            for k in 1..=40 {
                sum += at.impedance(f64::from(k)).r_ohm;
            }
            black_box(sum / 40.0)
        });
    });
    c.bench_function("a pot that was never seen, one curve", |b| {
        b.iter(|| {
            let mut map = PotMap::default();
            map.observe(black_box(curves[2].clone()));
            map
        });
    });
    let mut known = PotMap::default();
    for curve in &curves {
        known.observe(curve.clone());
    }
    for entries in [1, 20, MAX_ENTRIES] {
        let library = Arc::new(library(&known, entries));
        let name = format!("a pot that was never seen, one curve, {entries} pots in the library");
        c.bench_function(&name, |b| {
            b.iter(|| {
                let mut map = PotMap::default().with_library(library.clone());
                map.observe(black_box(curves[2].clone()));
                map
            });
        });
    }
    c.bench_function("five curves fitted again", |b| {
        b.iter(|| {
            let mut map = known.clone();
            map.refresh(black_box(1.0));
            map
        });
    });
    c.bench_function("136 cells of five curves", |b| {
        b.iter(|| known.cells(black_box(1.0)));
    });
    c.bench_function(
        "one more window of a known frequency, compared and fused",
        |b| {
            let again = curve(52e3, 37.0, 0.2);
            let mut settled = known.clone();
            for _ in 0..2 {
                settled.observe(again.clone());
            }
            b.iter_batched(
                || settled.clone(),
                |mut map| map.observe(black_box(again.clone())),
                criterion::BatchSize::SmallInput,
            );
        },
    );
}

/// The known pot, and others of many sizes and metals.
fn library(known: &PotMap, entries: usize) -> Library {
    let by = Provenance {
        hob: "bench".into(),
        build: "bench".into(),
        t_unix_s: 0,
    };
    let pot = known.entry(by).expect("well known").to_bytes();
    let pot: serde_json::Value = serde_json::from_slice(&pot).expect("JSON");
    let mut library = Library::default();
    for k in 0..entries {
        let mut other = pot.clone();
        let (size, metal) = ((k % 8) as f64, (k / 8) as f64);
        other["hobs"][0] = format!("hob-{}", k / 8).into();
        other["model"]["radius_m"] = (0.105 - 9.5e-3 * size).into();
        let ln_alpha = pot["model"]["ln_alpha"].as_f64().expect("a number");
        other["model"]["ln_alpha"] = (ln_alpha + 0.35 * metal).into();
        let bytes = serde_json::to_vec(&other).expect("JSON");
        let other = PotEntry::from_bytes(&bytes).expect("sound");
        library.add(other).expect("sound");
    }
    assert_eq!(library.entries().len(), entries);
    library
}

criterion_group!(benches, bench);
criterion_main!(benches);
