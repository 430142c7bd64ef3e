//! Import of 1 000 000 samples of two channels, against reading the file's bytes and, for the table,
//! against the standard library's split and parse.

mod scope_files;

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use ihd_capture::{OpenOptions, open};

const SAMPLES: usize = 1_000_000;

/// Time of a plain loop over lines and fields.
fn split_and_parse(path: &Path) -> Vec<[f64; 3]> {
    let text = std::fs::read_to_string(path).expect("read");
    let number = |field: &str| field.parse::<f64>().expect("number");
    let row = |line: &str| {
        let mut fields = line.split(',').map(number);
        std::array::from_fn(|_| fields.next().expect("field"))
    };
    text.lines().skip(1).map(row).collect()
}

fn import(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("folder");
    let folder = folder.path();
    let mut group = c.benchmark_group("import 1M x 2");
    group.sample_size(10);
    let [v, i] = scope_files::wfm(folder, SAMPLES);
    let pair = OpenOptions {
        second: Some(i.clone()),
        ..OpenOptions::default()
    };
    group.bench_function("wfm", |b| {
        b.iter(|| open(black_box(&v), &pair).expect("wfm"))
    });
    group.bench_function("wfm, bytes only", |b| {
        b.iter(|| {
            (
                std::fs::read(&v).expect("read"),
                std::fs::read(&i).expect("read"),
            )
        })
    });
    let single = OpenOptions::default();
    let csv = scope_files::csv(folder, SAMPLES);
    group.bench_function("csv", |b| {
        b.iter(|| open(black_box(&csv), &single).expect("csv"))
    });
    group.bench_function("csv, split and parse", |b| b.iter(|| split_and_parse(&csv)));
    for (name, path) in [
        ("mat", scope_files::mat(folder, SAMPLES)),
        ("npz", scope_files::npz(folder, SAMPLES)),
    ] {
        group.bench_function(name, |b| {
            b.iter(|| open(black_box(&path), &single).expect(name))
        });
    }
    group.finish();
}

criterion_group!(benches, import);
criterion_main!(benches);
