//! Commit times and sizes of a store on this machine, as docs/daemon.md shows them:
//! `cargo run -p ihd-store --example commit_times [FOLDER]`.

use std::error::Error;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use ihd_store::{Store, StoreOptions, StoreReader};

#[path = "../tests/it/fixture.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod fixture;

/// Windows, and results, that are stored.
const COUNT: u32 = 1_000;

fn main() -> Result<(), Box<dyn Error>> {
    let parent = std::env::args()
        .nth(1)
        .map_or_else(std::env::temp_dir, PathBuf::from);
    let folder = tempfile::tempdir_in(parent)?;
    let mut store = Store::open(folder.path(), &StoreOptions::default())?.store;
    let session = fixture::session(&mut store);
    let learned = vec![b'x'; 20_000];
    let (mut windows, mut results) = (Vec::new(), Vec::new());
    for seq in 0..COUNT {
        let window = fixture::window(seq);
        let began = Instant::now();
        store.keep_window(session, &window)?;
        windows.push(began.elapsed());
        let result = fixture::result(session, seq);
        let began = Instant::now();
        store.record_result(&result, Some(&learned))?;
        results.push(began.elapsed());
    }
    show("window, NORMAL", windows);
    show("result and learned state of 20 kB, FULL", results);
    let collected = store.collect_garbage()?;
    let window = fixture::window(0);
    let raw = 4 * window.pairs.len() + 8 * window.trajectory.len();
    println!(
        "a window of {raw} bytes takes {} on disk",
        collected.bytes_left / u64::from(COUNT)
    );
    drop(store);
    let began = Instant::now();
    drop(Store::open(folder.path(), &StoreOptions::default())?);
    println!(
        "a start checks {} MB in {:?}",
        collected.bytes_left / 1_000_000,
        began.elapsed()
    );
    let began = Instant::now();
    let report = StoreReader::open(folder.path())?.check()?;
    println!(
        "a check of {} windows: {} in {:?}",
        report.windows,
        report.integrity,
        began.elapsed()
    );
    Ok(())
}

fn show(what: &str, mut times: Vec<Duration>) {
    times.sort();
    let at = |share: usize| {
        times
            .get(times.len() * share / 100)
            .copied()
            .unwrap_or_default()
    };
    let worst = times.last().copied().unwrap_or_default();
    println!(
        "{what}: p50 {:?}, p99 {:?}, longest {worst:?}",
        at(50),
        at(99)
    );
}
