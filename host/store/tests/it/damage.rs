//! Damage by a disk: each kind is found at a start, set aside, reported and survived.

use std::fs;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use ihd_store::{
    InsertOutcome, ResultFilter, SamplePolicy, Store, StoreError, StoreOptions, StoreReader,
    WindowFilter,
};

use super::fixture::*;

const RECORDS: &str = "ihd.db";

/// A store with ten windows and results of it, closed.
fn filled(folder: &Path) -> String {
    let mut store = open(folder, &StoreOptions::default());
    let session = session(&mut store);
    for seq in 0..10 {
        store.keep_window(session, &window(seq)).unwrap();
        store
            .record_result(&result(session, seq), Some(b"{}"))
            .unwrap();
    }
    drop(store);
    let name = files(folder)
        .into_iter()
        .find(|name| name.starts_with("windows-"));
    name.unwrap()
}

/// Opens a damaged store: `name` alone was set aside, with its bytes, and all works on.
fn outlived(folder: &Path, name: &str, words: &str) {
    let path = folder.join(name);
    let bytes = fs::read(&path).ok();
    let opened = Store::open(folder, &StoreOptions::default()).unwrap();
    assert_eq!(opened.damage.len(), 1, "{words}: {:?}", opened.damage);
    let damage = &opened.damage[0];
    assert_eq!(damage.from, path);
    let set_aside = damage.to.file_name().unwrap().to_str().unwrap();
    assert!(
        set_aside.starts_with(&format!("{name}.damaged-20")),
        "{set_aside}"
    );
    assert!(damage.why.contains(words), "{words}: {}", damage.why);
    assert_eq!(
        fs::read(&damage.to).ok().map(|b| b.len()),
        bytes.map(|b| b.len())
    );
    let mut store = opened.store;
    let new = session(&mut store);
    assert_eq!(
        store.keep_window(new, &window(77)).unwrap(),
        InsertOutcome::New
    );
    store.record_result(&result(new, 77), Some(b"{}")).unwrap();
    drop(store);
    let reader = StoreReader::open(folder).unwrap();
    assert_eq!(reader.window("bench", 7, 77).unwrap(), Some(window(77)));
    let events = reader.events(10).unwrap();
    let told = events.iter().find(|event| event.kind == "damage").unwrap();
    assert!(
        told.text.contains(name) && told.text.contains(words),
        "{}",
        told.text
    );
    let all = ResultFilter::default();
    let kept = if name == RECORDS { 1 } else { 11 };
    assert_eq!(reader.results(&all).unwrap().len(), kept);
    // The other database is untouched.
    let windows = reader.windows(&WindowFilter::default()).unwrap().len();
    assert_eq!(windows, if name == RECORDS { 11 } else { 1 });
    open(folder, &StoreOptions::default());
}

fn write_at(path: &Path, at: u64, bytes: &[u8]) {
    let mut file = fs::File::options().write(true).open(path).unwrap();
    file.seek(SeekFrom::Start(at)).unwrap();
    file.write_all(bytes).unwrap();
}

/// Damages each of the two databases, each in a store of its own.
fn each_database(damage: impl Fn(&Path), words: &str) {
    for records in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let windows = filled(folder.path());
        let name = if records { RECORDS } else { &windows };
        damage(&folder.path().join(name));
        outlived(folder.path(), name, words);
    }
}

#[test]
fn a_header_of_garbage() {
    each_database(|path| write_at(path, 0, &[0x5A; 100]), "not a database");
}

#[test]
fn nothing_but_garbage() {
    let garbage: Vec<u8> = (0..70_000u32)
        .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    each_database(|path| fs::write(path, &garbage).unwrap(), "not a database");
}

#[test]
fn all_zeros() {
    let zeros = |path: &Path| {
        let length = fs::metadata(path).unwrap().len() as usize;
        fs::write(path, vec![0; length]).unwrap();
    };
    each_database(zeros, "not a database");
}

#[test]
fn pages_of_zeros() {
    let zeros = |path: &Path| {
        let pages = fs::metadata(path).unwrap().len() / 4_096;
        for page in 1..pages.min(12) {
            write_at(path, page * 4_096, &[0; 4_096]);
        }
    };
    each_database(zeros, "");
}

#[test]
fn a_tail_that_was_torn_off() {
    let cut = |path: &Path| {
        let length = fs::metadata(path).unwrap().len();
        let file = fs::File::options().write(true).open(path).unwrap();
        file.set_len(length * 6 / 10 / 4_096 * 4_096).unwrap();
    };
    each_database(cut, "");
}

#[test]
fn a_tail_that_was_torn_off_amid_a_page() {
    let cut = |path: &Path| {
        let length = fs::metadata(path).unwrap().len();
        let file = fs::File::options().write(true).open(path).unwrap();
        file.set_len(length - 4_096 - 1_234).unwrap();
    };
    each_database(cut, "");
}

#[test]
fn less_than_a_header() {
    let cut = |path: &Path| {
        let file = fs::File::options().write(true).open(path).unwrap();
        file.set_len(57).unwrap();
    };
    each_database(cut, "");
}

#[test]
fn a_directory_in_its_place() {
    let directory = |path: &Path| {
        fs::remove_file(path).unwrap();
        fs::create_dir(path).unwrap();
        fs::write(path.join("something"), "of somebody").unwrap();
    };
    each_database(directory, "no file");
}

#[test]
fn a_database_of_somebody_else() {
    let foreign = |path: &Path| {
        fs::remove_file(path).unwrap();
        let other = rusqlite::Connection::open(path).unwrap();
        other
            .execute_batch("CREATE TABLE devices (id); PRAGMA user_version = 1")
            .unwrap();
    };
    each_database(foreign, "another program");
}

#[test]
fn a_table_that_is_missing() {
    let without = |path: &Path| {
        let open = rusqlite::Connection::open(path).unwrap();
        let dropped =
            open.execute_batch("DROP TABLE IF EXISTS audit; DROP TABLE IF EXISTS windows");
        dropped.unwrap();
    };
    each_database(without, "table");
}

/// A database has its name only when its tables are on disk, so that no process leaves an empty one.
#[test]
fn an_empty_file_is_damage_and_a_database_that_was_not_made_to_the_end_is_none() {
    each_database(|path| fs::write(path, "").unwrap(), "0 bytes");
    let folder = tempfile::tempdir().unwrap();
    let windows = filled(folder.path());
    fs::write(folder.path().join(&windows), "").unwrap();
    let report = StoreReader::open(folder.path()).unwrap().check().unwrap();
    assert!(report.integrity.contains("0 bytes"), "{}", report.integrity);
    fs::write(folder.path().join(RECORDS), "").unwrap();
    let refused = StoreReader::open(folder.path()).err().unwrap();
    assert!(refused.is_damage() && refused.to_string().contains("0 bytes"));
    let folder = tempfile::tempdir().unwrap();
    for name in ["ihd.db.new", "ihd.db.new-wal", "windows-2026-11-22.db.new"] {
        fs::write(folder.path().join(name), "half of it").unwrap();
    }
    open(folder.path(), &StoreOptions::default());
    assert!(
        !files(folder.path())
            .iter()
            .any(|name| name.contains(".new"))
    );
}

/// The day's file is emptied while the store does not have it open.
#[test]
fn an_empty_day_under_way_is_set_aside_and_windows_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
    let mut store = opened.unwrap().store;
    let new = session(&mut store);
    fs::write(folder.path().join("windows-2026-11-22.db"), "").unwrap();
    assert_eq!(
        store.keep_window(new, &window(1)).unwrap(),
        InsertOutcome::New
    );
    let events = StoreReader::open(folder.path())
        .unwrap()
        .events(10)
        .unwrap();
    assert!(
        events
            .iter()
            .any(|event| event.kind == "damage" && event.text.contains("0 bytes"))
    );
    let set_aside = ihd_store::folder::damaged_days(folder.path()).unwrap();
    assert_eq!(set_aside.len(), 1);
}

/// Committed data is in the log until a checkpoint: a torn log gives what was whole.
#[test]
fn a_torn_log_gives_what_was_committed_before() {
    for cut in [1, 33, 5_000, 40_000] {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), &StoreOptions::default());
        let new = session(&mut store);
        for seq in 0..10 {
            store.keep_window(new, &window(seq)).unwrap();
        }
        let copy = tempfile::tempdir().unwrap();
        for name in files(folder.path()) {
            if !name.ends_with("-shm") {
                fs::copy(folder.path().join(&name), copy.path().join(&name)).unwrap();
            }
        }
        let names = files(copy.path());
        let log = names
            .iter()
            .find(|name| name.starts_with("windows-") && name.ends_with("-wal"));
        let log = copy.path().join(log.unwrap());
        let length = fs::metadata(&log).unwrap().len();
        let file = fs::File::options().write(true).open(&log).unwrap();
        file.set_len(length - cut).unwrap();
        let mut again = open(copy.path(), &StoreOptions::default());
        let have = StoreReader::open(copy.path())
            .unwrap()
            .windows(&WindowFilter::default())
            .unwrap();
        assert!((5..10).contains(&have.len()), "{cut}: {}", have.len());
        let session = session(&mut again);
        for seq in 0..10 {
            again.keep_window(session, &window(seq)).unwrap();
        }
        let have = StoreReader::open(copy.path())
            .unwrap()
            .windows(&WindowFilter::default())
            .unwrap();
        assert_eq!(have.len(), 10);
    }
}

#[test]
fn a_log_without_its_database_is_not_taken_for_that_of_a_new_one() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("ihd.db-wal"), [7; 9_000]).unwrap();
    fs::write(folder.path().join("windows-2026-11-22.db-wal"), [7; 9_000]).unwrap();
    fs::write(folder.path().join("notes-wal"), "of somebody").unwrap();
    let _store = open(folder.path(), &StoreOptions::default());
    let names = files(folder.path());
    assert!(names.contains(&"notes-wal".to_owned()));
    assert!(!names.contains(&"windows-2026-11-22.db-wal".to_owned()));
}

#[test]
fn tables_of_a_later_version_are_refused_by_name_and_left_alone() {
    for records in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let windows = filled(folder.path());
        let path = folder.path().join(if records { RECORDS } else { &windows });
        let later = rusqlite::Connection::open(&path).unwrap();
        later.pragma_update(None, "user_version", 999).unwrap();
        drop(later);
        let refused = Store::open(folder.path(), &StoreOptions::default())
            .err()
            .unwrap();
        assert!(
            matches!(refused, StoreError::Newer { version: 999, .. }),
            "{refused}"
        );
        assert!(
            refused.to_string().contains(path.to_str().unwrap()),
            "{refused}"
        );
        assert!(path.exists());
    }
}

/// A file that breaks while it is written is set aside then, and the window is stored in the next one.
#[test]
fn a_day_that_breaks_under_way() {
    let folder = tempfile::tempdir().unwrap();
    // More rows than SQLite keeps in memory.
    let mut store = open(
        folder.path(),
        &keeping(SamplePolicy::OneIn(1 << 30), 1 << 30, None),
    );
    let new = session(&mut store);
    for seq in 0..40_000 {
        store.keep_window(new, &sized(seq, 0)).unwrap();
    }
    store.collect_garbage().unwrap();
    let names = files(folder.path());
    let name = names
        .iter()
        .find(|n| n.starts_with("windows-") && n.ends_with(".db"));
    let path = folder.path().join(name.unwrap());
    let length = fs::metadata(&path).unwrap().len();
    write_at(&path, 4_096, &vec![0xA5; length as usize - 4_096]);
    let broken = (0..40_000)
        .find(|seq| store.keep_window(new, &sized(*seq, 0)).unwrap() == InsertOutcome::New);
    assert!(broken.is_some());
    store.keep_window(new, &sized(50_000, 0)).unwrap();
    let names = files(folder.path());
    assert!(
        names.iter().any(|name| name.contains(".damaged-")),
        "{names:?}"
    );
    let reader = StoreReader::open(folder.path()).unwrap();
    assert!(reader.windows(&WindowFilter::default()).unwrap().len() < 40_000);
    assert!(
        reader
            .events(10)
            .unwrap()
            .iter()
            .any(|event| event.kind == "damage")
    );
}

#[test]
fn a_folder_that_cannot_be_made_is_an_error_and_no_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    fs::write(&path, "x").unwrap();
    let error = Store::open(&path, &StoreOptions::default()).err().unwrap();
    assert!(
        !error.is_damage() && error.to_string().contains("making the folder"),
        "{error}"
    );
    let nowhere = StoreReader::open(&folder.path().join("nowhere"))
        .err()
        .unwrap();
    assert!(matches!(nowhere, StoreError::NoStore { .. }), "{nowhere}");
}
