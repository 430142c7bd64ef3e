//! The power fails at any moment: what a store's files are then, made from what they were before and after each write.
//!
//! A disk keeps what was synced. Of what was written since it may keep any part, in any order: here any of the sectors that differ, or
//! what lies before some byte. Nothing is kept of the shared memory (`-shm`), or garbage. Which writes are synced is what SQLite promises of
//! `synchronous`: of `ihd.db` each transaction, of a day what a checkpoint has copied. `IHD_STORE_CUTS=100` cuts each write so often.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{
    LookupState, OpenedStore, ResultFilter, SessionId, Store, StoreError, StoreOptions,
    StoreReader, WindowFilter,
};
use rusqlite::Connection;

use super::fixture::*;

/// Unit that a disk writes whole, or not.
const SECTOR: usize = 512;

const RECORDS: &str = "ihd.db";

/// Writes between two checkpoints of one database.
const CHECKPOINT_EVERY: u32 = 5;

/// Number of windows that are written, each with its result.
const WINDOWS: u32 = 12;

/// Chance, from a seed.
struct Chance(u64);

impl Chance {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % n.max(1)
    }

    /// A part of what differs is new: what lies before some byte, or any sectors.
    fn mixed(&mut self, old: &[u8], new: &[u8]) -> Vec<u8> {
        if old == new {
            return old.to_vec();
        }
        if self.below(2) == 0 {
            let first = old.iter().zip(new).take_while(|(a, b)| a == b).count();
            let end = first + self.below(new.len() + 1 - first);
            let mut bytes = new[..end].to_vec();
            bytes.extend(old.iter().skip(end));
            return bytes;
        }
        let mut bytes = old.to_vec();
        for (k, sector) in new.chunks(SECTOR).enumerate() {
            let at = k * SECTOR;
            if self.below(2) == 0 {
                let end = at + sector.len();
                bytes.resize(bytes.len().max(end), 0);
                bytes[at..end].copy_from_slice(sector);
            }
        }
        bytes
    }
}

/// Bytes of each file of a store.
type Files = BTreeMap<String, Vec<u8>>;

fn taken_from(folder: &Path) -> Files {
    let databases = files(folder).into_iter();
    let databases = databases.filter(|name| name.ends_with(".db") || name.ends_with(".db-wal"));
    databases
        .map(|name| (name.clone(), fs::read(folder.join(name)).unwrap()))
        .collect()
}

/// Acknowledged changes.
#[derive(Clone, Default)]
struct Acknowledged {
    results: u32,
    /// Version of the lookup that is active.
    active: u32,
    /// Windows of which the disk has each: those before the last checkpoint of their day.
    windows_synced: u32,
    windows: u32,
}

/// Writes of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Transactions, in the log.
    Log,
    /// Copies the log into the database.
    Checkpoint,
}

/// A store that is written, and what it was before.
struct Course {
    store: Store,
    folder: tempfile::TempDir,
    before: Files,
    acknowledged: Acknowledged,
    chance: Chance,
    cuts_a_step: usize,
    cuts: usize,
}

impl Course {
    /// Cuts what was written since the last step, so often; `now` was acknowledged with it.
    fn step(&mut self, step: Step, now: Acknowledged) {
        let after = taken_from(self.folder.path());
        for _ in 0..self.cuts_a_step {
            let cut = self.cut(step, &after);
            self.cuts += 1;
            let promised = &self.acknowledged;
            outlives(
                &cut,
                promised,
                &format!("cut {} in {step:?}", self.cuts),
                self.chance.below(2) == 0,
            );
        }
        if step == Step::Log && self.chance.below(3) == 0 {
            let cut = self.unsynced_day(&after);
            let promised = Acknowledged {
                windows: self.acknowledged.windows_synced,
                ..self.acknowledged.clone()
            };
            outlives(&cut, &promised, "the day's log", true);
        }
        self.before = after;
        self.acknowledged = now;
    }

    /// The files of a moment between those before and after.
    fn cut(&mut self, step: Step, after: &Files) -> Files {
        let mut cut = Files::new();
        // A database that is new has its name when it is whole.
        let has_new = self.chance.below(2) == 0;
        for (name, new) in after {
            let is_log = name.ends_with("-wal");
            let database = name.trim_end_matches("-wal");
            let is_new = !self.before.contains_key(database);
            let old = self.before.get(name).map(Vec::as_slice);
            // A checkpoint writes the log, then the database, then the log's length.
            let bytes = match (step, is_log) {
                _ if is_new && !has_new => continue,
                (Step::Log, false) if is_new => new.clone(),
                (Step::Log, true) | (Step::Checkpoint, false) => {
                    self.chance.mixed(old.unwrap_or_default(), new)
                }
                (Step::Log, false) | (Step::Checkpoint, true) => old.unwrap_or_default().to_vec(),
            };
            cut.insert(name.clone(), bytes);
        }
        cut
    }

    /// The same files, with a day's log cut off anywhere: nothing of it is synced.
    fn unsynced_day(&mut self, after: &Files) -> Files {
        let mut cut = after.clone();
        for (name, bytes) in &mut cut {
            if name.starts_with("windows-") && name.ends_with("-wal") {
                let length = self.chance.below(bytes.len() + 1);
                bytes.truncate(length);
            }
        }
        cut
    }

    fn checkpoint(&self, name: &str, how: &str) {
        let other = Connection::open(self.folder.path().join(name)).unwrap();
        let (busy, ..): (i64, i64, i64) = other
            .query_row(&format!("PRAGMA wal_checkpoint({how})"), [], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?))
            })
            .unwrap();
        assert_eq!(busy, 0);
    }

    fn day(&self) -> String {
        let days = files(self.folder.path()).into_iter();
        let mut days = days.filter(|n| n.starts_with("windows-") && n.ends_with(".db"));
        days.next().unwrap()
    }

    fn write(&mut self, session: SessionId, seq: u32) {
        let mut now = self.acknowledged.clone();
        self.store.keep_window(session, &sized(seq, 2_000)).unwrap();
        now.windows = seq + 1;
        self.step(Step::Log, now.clone());
        let learned = format!("learned {seq}");
        let result = result(session, seq);
        self.store
            .record_result(&result, Some(learned.as_bytes()))
            .unwrap();
        now.results = seq + 1;
        self.step(Step::Log, now.clone());
        if seq.is_multiple_of(3) {
            let device = self.store.device("bench", "").unwrap();
            let version = seq + 1;
            let lookup = RlLookup { version, ..prior() };
            self.store.pend_lookup(device, &lookup, "", None).unwrap();
            self.step(Step::Log, now.clone());
            self.store.adopt_lookup(device, &lookup).unwrap();
            now.active = version;
            self.step(Step::Log, now);
        }
    }
}

/// The store in a folder, on a day that does not end.
fn at_noon(folder: &Path) -> Result<OpenedStore, StoreError> {
    Store::open_with_clock(
        folder,
        &StoreOptions::default(),
        SetClock::at(NOON_MS).clock(),
    )
}

/// Opens a store of these files: it is whole, and what was promised is there.
fn outlives(files: &Files, promised: &Acknowledged, when: &str, with_garbage: bool) {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path: PathBuf = folder.path().join(name);
        // A log that was never written to disk has no name there either.
        if !(name.ends_with("-wal") && bytes.is_empty()) {
            fs::write(&path, bytes).unwrap();
        }
        if with_garbage && name.ends_with(".db") {
            fs::write(path.with_extension("db-shm"), [0xA5; 32_768]).unwrap();
        }
    }
    let opened = at_noon(folder.path());
    let opened = opened.unwrap_or_else(|error| panic!("{when}: {error}"));
    assert_eq!(opened.damage, [], "{when}");
    let mut store = opened.store;
    let reader = StoreReader::open(folder.path()).unwrap();
    let report = reader.check().unwrap();
    assert!(report.is_whole(), "{when}: {}", report.integrity);
    let all = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let mut results: Vec<u32> = reader
        .results(&all)
        .unwrap()
        .iter()
        .map(|row| row.seq)
        .collect();
    results.sort_unstable();
    let whole = |seqs: &[u32], least: u32| {
        let prefix = seqs.iter().copied().eq(0..seqs.len() as u32);
        prefix && (least..=least + 1).contains(&(seqs.len() as u32))
    };
    assert!(
        whole(&results, promised.results),
        "{when}: {} of {results:?}",
        promised.results
    );
    let windows = reader.windows(&WindowFilter::default()).unwrap();
    let mut windows: Vec<u32> = windows.iter().map(|row| row.seq).collect();
    windows.sort_unstable();
    // Of a log of which nothing is synced any first ones may be there.
    let is_prefix = windows.iter().copied().eq(0..windows.len() as u32);
    assert!(
        is_prefix && windows.len() as u32 >= promised.windows,
        "{when}: {} of {windows:?}",
        promised.windows
    );
    for seq in windows {
        let kept = reader.window("bench", 7, seq).unwrap();
        assert_eq!(kept, Some(sized(seq, 2_000)), "{when}");
    }
    let lookups = reader.lookups().unwrap();
    let active = lookups
        .iter()
        .filter(|row| row.state == LookupState::Active);
    let active: Vec<u32> = active.map(|row| row.version).collect();
    assert!(active.len() <= 1, "{when}: {active:?}");
    assert!(
        active
            .first()
            .is_none_or(|version| *version >= promised.active),
        "{when}"
    );
    assert!(promised.active == 0 || !active.is_empty(), "{when}");
    if let Some(last) = results.last() {
        let device = store.device("bench", "").unwrap();
        let learned = store.learner_state(device).unwrap();
        let expected = format!("learned {last}");
        assert_eq!(
            learned.as_deref(),
            Some(expected.as_bytes()),
            "{when}: one transaction"
        );
    }
    // It goes on.
    let session = session(&mut store);
    store.keep_window(session, &sized(1_000, 2_000)).unwrap();
}

#[test]
fn what_was_synced_outlives_a_power_cut() {
    let cuts = std::env::var("IHD_STORE_CUTS").map_or(1, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut store = at_noon(folder.path()).unwrap().store;
    let session = session(&mut store);
    let before = taken_from(folder.path());
    let mut course = Course {
        store,
        folder,
        before,
        acknowledged: Acknowledged::default(),
        chance: Chance(0x2545_F491_4F6C_DD1D),
        cuts_a_step: cuts,
        cuts: 0,
    };
    for seq in 0..WINDOWS {
        course.write(session, seq);
        if seq % CHECKPOINT_EVERY == CHECKPOINT_EVERY - 1 {
            // The log is written from its beginning again after the one, and is cut off with the other.
            let how = if seq < CHECKPOINT_EVERY {
                "PASSIVE"
            } else {
                "TRUNCATE"
            };
            course.checkpoint(RECORDS, how);
            let now = course.acknowledged.clone();
            course.step(Step::Checkpoint, now.clone());
            let day = course.day();
            course.checkpoint(&day, how);
            let windows_synced = now.windows;
            course.step(
                Step::Checkpoint,
                Acknowledged {
                    windows_synced,
                    ..now
                },
            );
        }
    }
    println!("{} cuts", course.cuts);
    assert!(course.cuts >= 30 * cuts);
}
