//! A writer is killed at any moment: what it had acknowledged is there, once, and the store is whole.
//! `IHD_STORE_KILLS=200` kills so often; 20 times where it is not said.

use std::collections::HashSet;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{LookupState, ResultFilter, StoreOptions, StoreReader, WindowFilter};

use super::fixture::*;
use super::fixture_process::{FOLDER, writer};

/// The writer: a no-op but in the process that [`killed_at_any_moment`] starts. Prints what is
/// acknowledged after it is, and nothing else.
#[test]
fn a_writer_that_is_killed() {
    let Some(folder) = std::env::var_os(FOLDER) else {
        return;
    };
    let mut store = open(Path::new(&folder), &StoreOptions::default());
    let session = session(&mut store);
    let device = store.device("bench", "").unwrap();
    let last = store
        .results(&ResultFilter {
            limit: Some(1),
            ..ResultFilter::default()
        })
        .unwrap();
    let first = last.first().map_or(0, |row| row.seq + 1);
    let mut out = std::io::stdout();
    writeln!(out, "\nfrom {first}").unwrap();
    for seq in first.. {
        store.keep_window(session, &sized(seq, 3_000)).unwrap();
        writeln!(out, "window {seq}").unwrap();
        let learned = format!("learned {seq}");
        store
            .record_result(&result(session, seq), Some(learned.as_bytes()))
            .unwrap();
        writeln!(out, "result {seq}").unwrap();
        if seq % 5 == 0 {
            let lookup = RlLookup {
                version: seq + 1,
                ..prior()
            };
            store.pend_lookup(device, &lookup, "", None).unwrap();
            writeln!(out, "pending {}", seq + 1).unwrap();
            store.adopt_lookup(device, &lookup).unwrap();
            writeln!(out, "active {}", seq + 1).unwrap();
        }
        if seq % 7 == 0 {
            store.collect_garbage().unwrap();
        }
    }
}

#[test]
fn killed_at_any_moment() {
    if std::env::var_os(FOLDER).is_some() {
        return;
    }
    let kills = std::env::var("IHD_STORE_KILLS").map_or(20, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut acknowledged: HashSet<(String, u32)> = HashSet::new();
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    for kill in 0..kills {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        let mut child = writer(
            "kill::a_writer_that_is_killed",
            folder.path(),
            "exec \"$@\"",
        )
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let reading = std::thread::spawn(move || lines.map_while(Result::ok).collect::<Vec<_>>());
        std::thread::sleep(Duration::from_micros(50_000 + random % 250_000));
        child.kill().unwrap();
        child.wait().unwrap();
        for line in reading.join().unwrap() {
            let mut words = line.split(' ');
            let (what, number) = (words.next(), words.next().and_then(|n| n.parse().ok()));
            if let (Some(what), Some(number)) = (what, number) {
                acknowledged.insert((what.to_owned(), number));
            }
        }
        whole(folder.path(), &acknowledged, kill);
    }
    let windows = acknowledged
        .iter()
        .filter(|(what, _)| what == "window")
        .count();
    assert!(windows > kills, "{windows} windows in {kills} lives");
}

fn whole(folder: &Path, acknowledged: &HashSet<(String, u32)>, kill: usize) {
    // Its own quick_check finds no damage.
    let store = open(folder, &StoreOptions::default());
    let reader = StoreReader::open(folder).unwrap();
    let all = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let results: Vec<u32> = reader
        .results(&all)
        .unwrap()
        .iter()
        .map(|row| row.seq)
        .collect();
    let windows = reader.windows(&WindowFilter::default()).unwrap();
    let windows: Vec<u32> = windows.iter().map(|row| row.seq).collect();
    let lookups = reader.lookups().unwrap();
    let active: Vec<_> = lookups
        .iter()
        .filter(|l| l.state == LookupState::Active)
        .collect();
    for (what, number) in acknowledged {
        let there = match what.as_str() {
            "window" => windows.contains(number),
            "result" => results.contains(number),
            "pending" => lookups.iter().any(|l| l.version == *number),
            "active" => active.len() == 1 && active[0].version >= *number,
            _ => true,
        };
        assert!(
            there,
            "kill {kill}: {what} {number} was acknowledged and is not there"
        );
    }
    // What was learned is of the last result: they are one transaction.
    if let Some(last) = results.first() {
        let device = lookups.first().map(|_| 1);
        let learned = device.map(|device| store.learner_state(device).unwrap().unwrap());
        assert!(learned.is_none_or(|l| l == format!("learned {last}").as_bytes()));
    }
    let unique: HashSet<&u32> = windows.iter().collect();
    assert_eq!(unique.len(), windows.len());
    for seq in windows.iter().rev().take(3) {
        assert_eq!(
            reader.window("bench", 7, *seq).unwrap(),
            Some(sized(*seq, 3_000))
        );
    }
}
