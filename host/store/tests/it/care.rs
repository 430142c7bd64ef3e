//! Check and backup, beside a writer.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};

use ihd_store::{Reader, ResultFilter, Settings, Store, StoreError, WindowFilter, backup};

use super::fixture::*;

#[test]
fn a_backup_while_it_is_written_is_whole_and_of_one_moment() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &Settings::default());
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
    let copy = Reader::open(&to).unwrap();
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
    open(&to, &Settings::default());
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

#[test]
fn a_check_reads_every_window_beside_the_writer() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &Settings::default());
    let session = session(&mut store);
    for seq in 0..20 {
        store.keep_window(session, &window(seq)).unwrap();
    }
    store.record_result(&result(session, 3), None).unwrap();
    let report = Reader::open(folder.path()).unwrap().check().unwrap();
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
    let opened = Store::open(folder.path(), &Settings::default()).unwrap();
    assert_eq!(opened.damage, [], "a start looks at pages");
    let reader = Reader::open(folder.path()).unwrap();
    let report = reader.check().unwrap();
    assert!(
        report.integrity.contains("cannot be unpacked"),
        "{}",
        report.integrity
    );
    assert_eq!((report.windows, report.windows_with_samples), (20, 19));
}
