//! Days are deleted by age and by size, today's never; what grows for ever does not.

use ihd_store::{Keep, Reader, Settings, Store, WindowFilter};

use super::fixture::*;

fn days(folder: &std::path::Path) -> Vec<String> {
    let mut names = files(folder);
    names.retain(|name| name.starts_with("windows-") && name.ends_with(".db"));
    names
}

/// A store with `days` days of three windows each, the last one today.
fn filled(folder: &std::path::Path, settings: &Settings, days: i64) -> (Store, SetClock) {
    let clock = SetClock::at(NOON_MS - (days - 1) * DAY_MS);
    let opened = Store::open_with_clock(folder, settings, clock.clock());
    let mut store = opened.unwrap().store;
    let session = session(&mut store);
    for day in 0..days {
        if day > 0 {
            clock.forward(DAY_MS);
        }
        for seq in 0..3 {
            let window = window(day as u32 * 10 + seq);
            store.keep_window(session, &window).unwrap();
        }
    }
    (store, clock)
}

#[test]
fn days_that_are_too_old_are_deleted_with_their_logs() {
    let folder = tempfile::tempdir().unwrap();
    let (mut store, clock) = filled(folder.path(), &keeping(Keep::All, 1 << 30, None), 5);
    assert_eq!(days(folder.path()).len(), 5);
    drop(store);
    let settings = keeping(Keep::All, 1 << 30, Some(2));
    store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    let collected = store.collect_garbage().unwrap();
    let left = [
        "windows-2026-11-20.db",
        "windows-2026-11-21.db",
        "windows-2026-11-22.db",
    ];
    assert_eq!(days(folder.path()), left);
    assert_eq!(collected.deleted.len(), 2);
    assert!(collected.bytes > 2 * 3 * 10_000, "{collected:?}");
    assert!(
        !files(folder.path())
            .iter()
            .any(|name| name.contains("11-18") || name.contains("11-19"))
    );
    // A day later, by itself, with the first window.
    clock.forward(DAY_MS);
    let session = session(&mut store);
    store.keep_window(session, &window(99)).unwrap();
    assert_eq!(days(folder.path())[0], "windows-2026-11-21.db");
}

#[test]
fn the_oldest_days_make_room_for_today() {
    let folder = tempfile::tempdir().unwrap();
    let (store, clock) = filled(folder.path(), &keeping(Keep::All, 1 << 30, None), 4);
    drop(store);
    let day_bytes = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().len();
    let two = day_bytes("windows-2026-11-21.db") + day_bytes("windows-2026-11-22.db");
    // Room for two days and a half.
    let settings = keeping(Keep::All, two * 5 / 4, None);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    let collected = store.collect_garbage().unwrap();
    assert_eq!(
        days(folder.path()),
        ["windows-2026-11-21.db", "windows-2026-11-22.db"]
    );
    assert!(collected.bytes_left <= two * 5 / 4 && !collected.today_is_too_large);
    let session = session(&mut store);
    for seq in 100..106 {
        store.keep_window(session, &window(seq)).unwrap();
    }
    assert_eq!(days(folder.path()), ["windows-2026-11-22.db"]);
    assert_eq!(store.figures().not_kept_for_size, 0);
}

#[test]
fn when_today_alone_is_too_large_rows_are_kept_and_samples_counted_as_not() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let settings = keeping(Keep::All, 600_000, None);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    let session = session(&mut store);
    for seq in 0..200 {
        store.keep_window(session, &window(seq)).unwrap();
    }
    let figures = store.figures();
    assert!(figures.not_kept_for_size > 150, "{figures:?}");
    assert_eq!(figures.windows, 200);
    assert!(store.collect_garbage().unwrap().today_is_too_large);
    let size = std::fs::metadata(folder.path().join("windows-2026-11-22.db"))
        .unwrap()
        .len();
    assert!(size < 700_000, "{size}");
    let reader = Reader::open(folder.path()).unwrap();
    let rows = reader.windows(&WindowFilter::default()).unwrap();
    assert_eq!(rows.len(), 200);
    assert_eq!(rows[199].not_kept.as_deref(), Some("size"));
    // It is told once, not two hundred times.
    let told = reader.events(100).unwrap();
    assert_eq!(
        told.iter().filter(|event| event.kind == "store").count(),
        1,
        "{told:?}"
    );
    // Tomorrow there is room again.
    clock.forward(DAY_MS);
    store.keep_window(session, &window(900)).unwrap();
    assert!(reader.window("bench", 7, 900).unwrap().is_some());
    assert_eq!(days(folder.path()), ["windows-2026-11-23.db"]);
}

#[test]
fn room_that_was_freed_is_used_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &keeping(Keep::Telling, 600_000, None));
    let session = session(&mut store);
    for seq in 0..200 {
        store.keep_window(session, &window(seq)).unwrap();
        store.record_result(&result(session, seq), None).unwrap();
    }
    assert_eq!(store.figures().not_kept_for_size, 0);
    let collected = store.collect_garbage().unwrap();
    assert!(collected.bytes_left < 600_000, "{collected:?}");
}

#[test]
fn damaged_days_count_and_go_too() {
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder
        .path()
        .join("windows-2026-11-01.db.damaged-20261102T000000Z");
    std::fs::write(&damaged, vec![0; 500_000]).unwrap();
    let (mut store, _) = filled(folder.path(), &keeping(Keep::All, 400_000, None), 1);
    store.collect_garbage().unwrap();
    assert!(!damaged.exists());
    assert_eq!(days(folder.path()), ["windows-2026-11-22.db"]);
}
