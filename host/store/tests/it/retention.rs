//! Days are deleted by age, windows are thinned for room, the newest last; what grows for ever does not.

use ihd_store::{
    NewResult, ResultFilter, SamplePolicy, Store, StoreOptions, StoreReader, WindowFilter,
};

use super::fixture::*;

fn days(folder: &std::path::Path) -> Vec<String> {
    let mut names = files(folder);
    names.retain(|name| name.starts_with("windows-") && name.ends_with(".db"));
    names
}

/// A store with `days` days of three windows each, the last one today.
fn filled(folder: &std::path::Path, settings: &StoreOptions, days: i64) -> (Store, SetClock) {
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

/// Opens a store again with other settings.
fn again(
    store: Store,
    folder: &std::path::Path,
    settings: &StoreOptions,
    clock: &SetClock,
) -> Store {
    drop(store);
    let opened = Store::open_with_clock(folder, settings, clock.clock());
    opened.unwrap().store
}

/// Numbers of the windows that have their samples, in order.
fn whole(folder: &std::path::Path) -> Vec<u32> {
    let rows = StoreReader::open(folder)
        .unwrap()
        .windows(&WindowFilter::default());
    let mut rows = rows.unwrap();
    rows.retain(|row| row.not_kept.is_none());
    rows.iter().map(|row| row.seq).collect()
}

/// Bytes of all days on disk, after a collection.
fn bytes(folder: &std::path::Path) -> u64 {
    let size = |name: &String| std::fs::metadata(folder.join(name)).unwrap().len();
    days(folder).iter().map(size).sum()
}

#[test]
fn days_that_are_too_old_are_deleted_with_their_logs() {
    let folder = tempfile::tempdir().unwrap();
    let settings = keeping(SamplePolicy::All, 1 << 30, Some(1));
    let (mut store, clock) = filled(folder.path(), &settings, 1);
    store.collect_garbage().unwrap();
    live(&mut store, &clock, 2 * DAY_MS - 3_600_000);
    assert_eq!(days(folder.path()), ["windows-2026-11-22.db"]);
    let session = session(&mut store);
    store.keep_window(session, &window(99)).unwrap();
    assert_eq!(days(folder.path()).len(), 2);
    live(&mut store, &clock, 2 * 3_600_000);
    assert_eq!(days(folder.path()), ["windows-2026-11-24.db"]);
    assert!(
        !files(folder.path())
            .iter()
            .any(|name| name.contains("11-22"))
    );
}

/// Ten years forward, back, and off for a year: age is time in use.
#[test]
fn no_jump_of_the_clock_deletes_a_day() {
    let folder = tempfile::tempdir().unwrap();
    let settings = keeping(SamplePolicy::All, 1 << 30, Some(2));
    let (mut store, clock) = filled(folder.path(), &settings, 3);
    let there = days(folder.path());
    let mut session = session(&mut store);
    for (k, jump_ms) in [3_650, -3_650, -400, 400, 3_650, 365]
        .map(|d| d * DAY_MS)
        .into_iter()
        .enumerate()
    {
        store.collect_garbage().unwrap();
        clock.forward(jump_ms);
        store.keep_window(session, &window(100 + k as u32)).unwrap();
        store.collect_garbage().unwrap();
        store = again(store, folder.path(), &settings, &clock);
        store.collect_garbage().unwrap();
        session = super::fixture::session(&mut store);
        let left = days(folder.path());
        assert!(
            there.iter().all(|day| left.contains(day)),
            "{jump_ms}: {left:?}"
        );
    }
    assert_eq!(whole(folder.path()).len(), 9 + 6);
}

#[test]
fn the_newest_windows_stay_when_there_is_no_room_for_all() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let max = 2_400_000;
    let opened = Store::open_with_clock(
        folder.path(),
        &keeping(SamplePolicy::All, max, None),
        clock.clock(),
    );
    let mut store = opened.unwrap().store;
    let session = session(&mut store);
    for seq in 0..200 {
        // A jump amid it makes none of them old.
        clock.forward(if seq == 150 { 300_000_000 } else { 200 });
        store.keep_window(session, &window(seq)).unwrap();
        assert_eq!(whole(folder.path()).last(), Some(&seq));
    }
    store.collect_garbage().unwrap();
    let left = whole(folder.path());
    let newest: Vec<u32> = (200 - left.len() as u32..200).collect();
    assert_eq!(left, newest);
    assert!(
        left.len() >= 50,
        "{} of {max} bytes, {left:?}",
        bytes(folder.path())
    );
    assert!(
        bytes(folder.path()) < max + max / 5,
        "{}",
        bytes(folder.path())
    );
    let figures = store.figures();
    assert_eq!((figures.windows, figures.not_kept_for_size), (200, 0));
    let reader = StoreReader::open(folder.path()).unwrap();
    let rows = reader.windows(&WindowFilter::default()).unwrap();
    assert_eq!(rows[0].not_kept.as_deref(), Some("thinned"));
}

/// A day with a window each 20 s, of which the network has identified each second, and a step of R amid them; then an hour of now.
#[test]
fn older_windows_are_thinned_to_changes_then_to_minutes_and_the_last_hour_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let all = keeping(SamplePolicy::All, 1 << 30, None);
    let mut store = Store::open_with_clock(folder.path(), &all, clock.clock())
        .unwrap()
        .store;
    let of = session(&mut store);
    let store_one = |store: &mut Store, seq: u32, r_ohm: Option<f64>| {
        clock.forward(20_000);
        store.keep_window(of, &window(seq)).unwrap();
        if let Some(r_ohm) = r_ohm {
            let identified = NewResult {
                r_ohm,
                sigma_r_pct: 1.0,
                ..result(of, seq)
            };
            store.record_result(&identified, None).unwrap();
        }
    };
    for seq in 0..60 {
        // Within a deviation until 30, then beyond it with every result.
        let r_ohm = if seq < 30 {
            2.0 + 0.001 * f64::from(seq % 4)
        } else {
            3.0 + 0.1 * f64::from(seq)
        };
        store_one(&mut store, seq, (seq % 2 == 0).then_some(r_ohm));
    }
    clock.forward(DAY_MS);
    for seq in 100..280 {
        store_one(&mut store, seq, None);
    }
    store.collect_garbage().unwrap();
    let each = bytes(folder.path()) / 240;
    let changed: Vec<u32> = [0].into_iter().chain((30..60).step_by(2)).collect();
    let last_hour: Vec<u32> = (100..280).collect();
    // Room for all of the last hour and of the changes.
    let mut settings = keeping(SamplePolicy::All, each * (180 + 17) + 100_000, None);
    let mut store = again(store, folder.path(), &settings, &clock);
    store.collect_garbage().unwrap();
    assert_eq!(
        whole(folder.path()),
        [changed.clone(), last_hour.clone()].concat()
    );
    assert!(bytes(folder.path()) <= settings.retention.max_bytes);
    // Room for less: of the changes one a minute.
    settings.retention.max_bytes = each * (180 + 12) + 100_000;
    let mut store = again(store, folder.path(), &settings, &clock);
    store.collect_garbage().unwrap();
    let left = whole(folder.path());
    assert_eq!(left[left.len() - 180..], last_hour);
    let older = &left[..left.len() - 180];
    // Rows 0, 30, 32, … at 20 s each, in minutes of three.
    let minute = |seq: &u32| (seq + 1) / 3;
    let mut minutes: Vec<u32> = older.iter().map(minute).collect();
    minutes.dedup();
    assert_eq!(minutes.len(), older.len(), "{older:?}");
    assert!(
        older.len() >= 5 && older.iter().all(|seq| changed.contains(seq)),
        "{older:?}"
    );
    assert!(bytes(folder.path()) <= settings.retention.max_bytes);
    // Every result is there.
    let filter = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    assert_eq!(
        StoreReader::open(folder.path())
            .unwrap()
            .results(&filter)
            .unwrap()
            .len(),
        30
    );
    // Less than the last hour: the day before goes, then the oldest of the hour.
    settings.retention.max_bytes = each * 100;
    let mut store = again(store, folder.path(), &settings, &clock);
    store.collect_garbage().unwrap();
    assert_eq!(days(folder.path()), ["windows-2026-11-23.db"]);
    let left = whole(folder.path());
    assert_eq!(left, last_hour[180 - left.len()..]);
    assert!(left.len() > 80, "{}", left.len());
}

/// A file of before that cannot give room back goes before anything newer is thinned.
#[test]
fn a_day_that_cannot_shrink_goes_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (store, clock) = filled(folder.path(), &keeping(SamplePolicy::All, 1 << 30, None), 2);
    drop(store);
    let old = folder.path().join("windows-2026-11-21.db");
    let plain = rusqlite::Connection::open(&old).unwrap();
    plain
        .execute_batch("PRAGMA auto_vacuum = NONE; VACUUM")
        .unwrap();
    drop(plain);
    let size = std::fs::metadata(folder.path().join("windows-2026-11-22.db"))
        .unwrap()
        .len();
    let settings = keeping(SamplePolicy::All, size + 50_000, None);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    let collected = store.collect_garbage().unwrap();
    assert_eq!(collected.deleted, [old]);
    assert_eq!(whole(folder.path()), [10, 11, 12]);
}

#[test]
fn room_that_was_freed_is_used_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(
        folder.path(),
        &keeping(SamplePolicy::Informative, 600_000, None),
    );
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
    let (mut store, _) = filled(folder.path(), &keeping(SamplePolicy::All, 400_000, None), 1);
    store.collect_garbage().unwrap();
    assert!(!damaged.exists());
    assert_eq!(days(folder.path()), ["windows-2026-11-22.db"]);
}

/// A link to nothing stands for a day that is deleted between the listing of the folder and its opening.
#[cfg(unix)]
#[test]
fn a_day_that_is_deleted_while_it_is_read_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let (_store, _) = filled(folder.path(), &keeping(SamplePolicy::All, 1 << 30, None), 2);
    let deleted = folder.path().join("windows-2026-11-20.db");
    std::os::unix::fs::symlink(folder.path().join("nothing"), deleted).unwrap();
    assert_eq!(whole(folder.path()), [0, 1, 2, 10, 11, 12]);
    let reader = StoreReader::open(folder.path()).unwrap();
    assert_eq!(reader.last_windows("bench", 100, true).unwrap().len(), 6);
    assert_eq!(reader.window("bench", 7, 99).unwrap(), None);
    assert!(reader.whole_window("bench", 7, 99).unwrap().is_none());
    assert_eq!(reader.space().unwrap().len(), 2);
    assert!(reader.check().unwrap().is_whole());
}
