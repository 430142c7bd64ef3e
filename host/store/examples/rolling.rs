//! Cost of a window while older ones make room for it: `cargo run --release -p ihd-store --example rolling [FOLDER]`.

use std::error::Error;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use ihd_store::{NewResult, SamplePolicy, Store};

#[path = "../tests/it/fixture.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod fixture;

/// Windows of each of two days, one a second.
const A_DAY: u32 = 10_000;

/// Bytes that windows may take: those of 6400, of which 3600 are the last hour.
const MAX_BYTES: u64 = 200_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let parent = std::env::args()
        .nth(1)
        .map_or_else(std::env::temp_dir, PathBuf::from);
    let folder = tempfile::tempdir_in(parent)?;
    let clock = fixture::SetClock::at(fixture::NOON_MS);
    let settings = fixture::keeping(SamplePolicy::All, MAX_BYTES, None);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())?.store;
    let session = fixture::session(&mut store);
    let (mut alone, mut today, mut other) = (Vec::new(), Vec::new(), Vec::new());
    for seq in 0..2 * A_DAY {
        clock.forward(if seq == A_DAY { fixture::DAY_MS } else { 1_000 });
        let window = fixture::window(seq);
        let thinned = store.figures().thinned;
        let began = Instant::now();
        store.keep_window(session, &window)?;
        let took = began.elapsed();
        match (store.figures().thinned > thinned, seq < A_DAY) {
            (false, _) => alone.push(took),
            (true, true) => today.push(took),
            (true, false) => other.push(took),
        }
        if seq % 10 == 0 {
            let r_ohm = 2.0 + 0.1 * f64::from(seq / 500);
            let result = NewResult {
                r_ohm,
                ..fixture::result(session, seq)
            };
            store.record_result(&result, None)?;
        }
        if seq % 600 == 0 {
            store.collect_garbage()?;
        }
    }
    show("no window thinned", alone);
    show("with windows of today thinned", today);
    show("with windows of both days thinned", other);
    let began = Instant::now();
    let collected = store.collect_garbage()?;
    println!(
        "a collection takes {:?}; {} MB are left",
        began.elapsed(),
        collected.bytes_left / 1_000_000
    );
    for day in ihd_store::folder::days(folder.path())? {
        let bytes = ihd_store::folder::size(&day.path);
        println!("{}: {} MB", day.day, bytes / 1_000_000);
    }
    println!("{:?}", store.figures());
    Ok(())
}

fn show(what: &str, mut took: Vec<Duration>) {
    took.sort();
    let at = |share: f64| {
        took.get((share * took.len() as f64) as usize)
            .copied()
            .unwrap_or_default()
    };
    println!(
        "{what}: {} windows, p50 {:?}, p99 {:?}, longest {:?}",
        took.len(),
        at(0.5),
        at(0.99),
        took.last()
    );
}
