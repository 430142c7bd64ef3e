//! Check and backup, beside a writer.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};

use ihd_store::{ResultFilter, Store, StoreError, StoreOptions, StoreReader, WindowFilter, backup};

use super::fixture::*;

#[test]
fn a_backup_while_it_is_written_is_whole_and_of_one_moment() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    for seq in 0..50 {
        store.keep_window(session, &window(seq)).unwrap();
        store
            .record_result(&result(session, seq), Some(b"{}"))
            .unwrap();
    }
    let (written, stop) = (
        std::sync::atomic::AtomicU32::new(50),
        AtomicBool::new(false),
    );
    let to = folder.path().join("backup");
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for seq in 50.. {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                store.keep_window(session, &window(seq)).unwrap();
                store
                    .record_result(&result(session, seq), Some(b"{}"))
                    .unwrap();
                written.store(seq + 1, Ordering::Relaxed);
            }
        });
        let copied = backup(folder.path(), &to);
        stop.store(true, Ordering::Relaxed);
        copied.unwrap();
    });
    let copy = StoreReader::open(&to).unwrap();
    let report = copy.check().unwrap();
    assert_eq!(report.integrity, "ok");
    assert!(
        (50..=u64::from(written.into_inner())).contains(&report.results),
        "{report:?}"
    );
    // Every window that a result speaks of is there.
    let all = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let windows = copy.windows(&WindowFilter::default()).unwrap();
    for row in copy.results(&all).unwrap() {
        assert!(
            windows.iter().any(|w| w.seq == row.seq),
            "window {}",
            row.seq
        );
    }
    drop(copy);
    // It is a store as any other.
    open(&to, &StoreOptions::default());
    assert!(
        files(folder.path())
            .iter()
            .all(|name| !name.contains(".partial"))
    );
    let again = backup(folder.path(), &to);
    assert!(matches!(again, Err(StoreError::Exists { .. })));
    let none = backup(&folder.path().join("none"), &folder.path().join("b"));
    assert!(matches!(none, Err(StoreError::NoStore { .. })));
    assert!(!folder.path().join("b").exists());
}

/// A backup that was killed is never under a backup's name, and the next one removes what it left; one that runs is left alone.
#[test]
fn what_a_killed_backup_leaves_is_hidden_and_goes() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    store.keep_window(session, &window(1)).unwrap();
    let backups = folder.path().join("backups");
    let leave = |name: &str| {
        fs::create_dir_all(backups.join(name)).unwrap();
        fs::write(backups.join(name).join("ihd.db"), "half of it").unwrap();
        fs::File::create(backups.join(format!("{name}.lock"))).unwrap()
    };
    drop(leave(".killed.4711-0.partial"));
    let runs = leave(".runs.4712-0.partial");
    runs.try_lock().unwrap();
    backup(folder.path(), &backups.join("whole")).unwrap();
    let left = [".runs.4712-0.partial", ".runs.4712-0.partial.lock", "whole"];
    assert_eq!(files(&backups), left);
    drop(runs);
    drop(store);
    // A daemon that starts looks there, too.
    open(folder.path(), &StoreOptions::default());
    assert_eq!(files(&backups), ["whole"]);
    // A backup that fails on its way leaves nothing.
    fs::write(
        folder.path().join("windows-2026-11-21.db"),
        "not a database",
    )
    .unwrap();
    assert!(backup(folder.path(), &backups.join("fails")).is_err());
    assert_eq!(files(&backups), ["whole"]);
}

#[test]
fn a_check_reads_every_window_beside_the_writer() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    for seq in 0..20 {
        store.keep_window(session, &window(seq)).unwrap();
    }
    store.record_result(&result(session, 3), None).unwrap();
    let report = StoreReader::open(folder.path()).unwrap().check().unwrap();
    assert!(report.is_whole());
    assert_eq!(
        (report.windows, report.windows_with_samples, report.results),
        (20, 20, 1)
    );
    drop(store);
    // A flipped bit amid the samples, which no check of SQLite's sees.
    let names = files(folder.path());
    let path = folder.path().join(
        names
            .iter()
            .find(|name| name.starts_with("windows-"))
            .unwrap(),
    );
    let mut bytes = fs::read(&path).unwrap();
    let amid = bytes.len() / 2 / 4_096 * 4_096 + 2_000;
    bytes[amid] ^= 0x10;
    fs::write(&path, &bytes).unwrap();
    let opened = Store::open(folder.path(), &StoreOptions::default()).unwrap();
    assert_eq!(opened.damage, [], "a start looks at pages");
    let reader = StoreReader::open(folder.path()).unwrap();
    let report = reader.check().unwrap();
    assert!(
        report.integrity.contains("cannot be unpacked"),
        "{}",
        report.integrity
    );
    assert_eq!((report.windows, report.windows_with_samples), (20, 19));
}
