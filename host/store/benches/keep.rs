//! Time until a window and a result are committed: NORMAL and FULL, on the disk of the folder that
//! `TMPDIR` names.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ihd_store::{Store, StoreOptions};

#[path = "../tests/it/fixture.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod fixture;

fn commits(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a folder");
    let opened = Store::open(folder.path(), &StoreOptions::default());
    let mut store = opened.expect("a store").store;
    let session = fixture::session(&mut store);
    let mut group = c.benchmark_group("store");
    group.sample_size(50);
    let window = fixture::window(0);
    let raw_bytes = 4 * window.pairs.len() + 8 * window.trajectory.len();
    group.throughput(Throughput::Bytes(raw_bytes as u64));
    let mut seq = 0;
    group.bench_function("keep_window", |b| {
        b.iter(|| {
            seq += 1;
            let window = ihd_link::Window {
                seq,
                ..window.clone()
            };
            store.keep_window(session, &window).expect("stored")
        });
    });
    group.throughput(Throughput::Elements(1));
    let learned = vec![b'x'; 20_000];
    let mut seq = 0;
    group.bench_function("record_result", |b| {
        b.iter(|| {
            seq += 1;
            let result = fixture::result(session, seq);
            store
                .record_result(&result, Some(&learned))
                .expect("stored")
        });
    });
    group.finish();
}

criterion_group!(benches, commits);
criterion_main!(benches);
