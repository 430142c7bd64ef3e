//! No room: an error that says so, nothing half-written, and on it goes when there is room again.

use std::io::{BufRead, BufReader, Write, stdin};
use std::path::Path;
use std::process::Stdio;

use ihd_store::{
    InsertOutcome, ResultFilter, SamplePolicy, Store, StoreOptions, StoreReader, WindowFilter,
};
use rusqlite::Connection;

use super::fixture::*;
use super::fixture_process::{FOLDER, writer};

/// A writer whose files may not grow beyond a limit: a no-op but in the process that
/// [`a_limit_of_the_files_size`] starts. The limit hits the windows first, and then the records.
#[test]
fn a_writer_that_is_limited() {
    let Some(folder) = std::env::var_os(FOLDER) else {
        return;
    };
    let mut store = open(Path::new(&folder), &StoreOptions::default());
    let session = session(&mut store);
    let mut stored = 0;
    let full = loop {
        match store.keep_window(session, &window(stored)) {
            Ok(InsertOutcome::New) => stored += 1,
            Ok(InsertOutcome::Known) => panic!("{stored} was known"),
            Err(error) => break error,
        }
    };
    assert!(full.is_full(), "{full}");
    assert!(
        store
            .keep_window(session, &window(stored))
            .unwrap_err()
            .is_full()
    );
    let trial = store.try_writing().unwrap_err();
    assert!(trial.is_full() && trial.is_of_storage(), "{trial}");
    let mut results = 0;
    let full = loop {
        match store.record_result(&result(session, results), Some(&[b'x'; 20_000])) {
            Ok(_) => results += 1,
            Err(error) => break error,
        }
    };
    assert!(full.is_full(), "{full}");
    assert!(!full.is_damage());
    println!("\nstored {stored} {results}");
}

#[test]
fn a_limit_of_the_files_size() {
    if std::env::var_os(FOLDER).is_some() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // In units of 512 bytes: 1 MiB. The signal ends a process that does not ignore it.
    let shell = "trap '' XFSZ; ulimit -f 2048; exec \"$@\"";
    let output = writer("room::a_writer_that_is_limited", folder.path(), shell)
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}\n{errors}");
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("stored "))
        .unwrap();
    let counts: Vec<usize> = line.split(' ').map(|n| n.parse().unwrap()).collect();
    assert!(counts[0] > 5 && counts[1] > 5, "{counts:?}");
    // Without the limit: all that was acknowledged is there, and no more, and it goes on.
    let mut store = open(folder.path(), &StoreOptions::default());
    store.try_writing().unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let windows = || reader.windows(&WindowFilter::default()).unwrap().len();
    let all = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    assert_eq!(
        (windows(), reader.results(&all).unwrap().len()),
        (counts[0], counts[1])
    );
    let session = session(&mut store);
    store
        .keep_window(session, &window(counts[0] as u32))
        .unwrap();
    store
        .record_result(&result(session, counts[1] as u32), None)
        .unwrap();
    assert_eq!(windows(), counts[0] + 1);
}

/// A start without room, in the process that [`a_full_disk_is_no_reason_not_to_start`] starts: SQLite's log of `ihd.db` may not grow.
#[test]
fn a_writer_that_starts_without_room() {
    let Some(folder) = std::env::var_os(FOLDER) else {
        return;
    };
    let clock = SetClock::at(NOON_MS + 3 * DAY_MS);
    let settings = keeping(SamplePolicy::All, 1 << 30, Some(0));
    let opened = Store::open_with_clock(Path::new(&folder), &settings, clock.clock());
    let mut store = opened.unwrap().store;
    assert!(store.device("bench", "serial:a").unwrap_err().is_full());
    let collected = store.collect_garbage().unwrap_err();
    assert!(collected.is_full(), "{collected}");
    println!("\nfull");
    stdin().read_line(&mut String::new()).unwrap();
    session(&mut store);
}

#[test]
fn a_full_disk_is_no_reason_not_to_start() {
    if std::env::var_os(FOLDER).is_some() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let settings = keeping(SamplePolicy::All, 1 << 30, Some(30));
    let opened = Store::open_with_clock(folder.path(), &settings, clock.clock());
    let mut store = opened.unwrap().store;
    let cut_off = session(&mut store);
    store.keep_window(cut_off, &window(1)).unwrap();
    store.collect_garbage().unwrap();
    live(&mut store, &clock, 2 * DAY_MS);
    // A reader keeps the log, which is longer than the limit then.
    let reader = Connection::open(folder.path().join("ihd.db")).unwrap();
    reader
        .execute_batch("BEGIN; SELECT * FROM sessions")
        .unwrap();
    for _ in 0..40 {
        store.event(None, "store", "a page of the log").unwrap();
    }
    drop(store);
    // In units of 512 bytes: 64 kiB, of which SQLite's shared memory takes 32.
    let shell = "trap '' XFSZ; ulimit -f 128; exec \"$@\"";
    let test = "room::a_writer_that_starts_without_room";
    let mut command = writer(test, folder.path(), shell);
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(
        lines.any(|line| line.unwrap() == "full"),
        "it did not start"
    );
    // What is too old goes before anything is written.
    let names = files(folder.path());
    assert!(
        !names.iter().any(|name| name.starts_with("windows-")),
        "{names:?}"
    );
    let reader_ends = "COMMIT; PRAGMA wal_checkpoint(TRUNCATE)";
    reader.execute_batch(reader_ends).unwrap();
    child.stdin.take().unwrap().write_all(b"\n").unwrap();
    assert!(lines.all(|line| line.is_ok()));
    assert!(child.wait().unwrap().success());
    // With room, the next session ends the one that was cut off, and not itself.
    let reader = StoreReader::open(folder.path()).unwrap();
    let ended = |id| reader.session(id).unwrap().unwrap().why;
    assert!(ended(cut_off).unwrap().starts_with("cut off"));
    assert_eq!(ended(cut_off + 1), None);
}
