//! No room: an error that says so, nothing half-written, and on it goes when there is room again.

use std::path::Path;

use ihd_store::{InsertOutcome, ResultFilter, StoreOptions, StoreReader, WindowFilter};

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
