//! Windows are read back as stored, once, bit for bit.

use ihd_link::Window;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{Pair, Scales};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_store::{
    InsertOutcome, ResultFilter, SamplePolicy, Store, StoreError, StoreOptions, StoreReader,
    WindowFilter,
};
use proptest::prelude::*;

use super::fixture::*;

fn any_window() -> impl Strategy<Value = Window> {
    let pairs = prop::collection::vec((any::<i16>(), any::<i16>()), 0..700);
    let trajectory = prop::collection::vec((any::<i32>(), any::<i32>()), 0..272);
    let numbers = (
        any::<[u32; 5]>(),
        any::<[i32; 2]>(),
        any::<u16>(),
        any::<[u32; 2]>(),
    );
    (pairs, trajectory, numbers).prop_map(|(pairs, trajectory, (u, i, saturated, scales))| Window {
        seq: u[0],
        half_cycle: u[1],
        f_sw_hz: u[2],
        half_cycle_ns: u[3],
        first_pair_ns: i[0],
        pairs: pairs.into_iter().map(|(v, i)| Pair { v, i }).collect(),
        first_trajectory_ns: i[1],
        trajectory: trajectory
            .into_iter()
            .map(|(r, l)| TrajectoryEntry {
                r: MicroOhm(r),
                l: PicoHenry(l),
            })
            .collect(),
        saturated,
        lookup_version: u[4],
        scales: Scales {
            v_full_scale_mv: scales[0],
            i_full_scale_ma: scales[1],
        },
    })
}

#[test]
fn any_window_comes_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    let reader = StoreReader::open(folder.path()).unwrap();
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(60));
    let store = std::cell::RefCell::new(store);
    let stored = runner.run(&any_window(), |window| {
        let kept = store.borrow_mut().keep_window(session, &window).unwrap();
        if kept == InsertOutcome::New {
            let back = reader.window("bench", 7, window.seq).unwrap();
            prop_assert_eq!(back, Some(window));
        }
        Ok(())
    });
    stored.unwrap();
}

#[test]
fn a_window_that_comes_twice_is_stored_once_across_sessions_restarts_and_midnight() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let open = || {
        let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
        opened.unwrap().store
    };
    let mut store = open();
    let first = session(&mut store);
    assert_eq!(
        store.keep_window(first, &window(5)).unwrap(),
        InsertOutcome::New
    );
    assert_eq!(
        store.keep_window(first, &window(5)).unwrap(),
        InsertOutcome::Known
    );
    let second = session(&mut store);
    assert_eq!(
        store.keep_window(second, &window(5)).unwrap(),
        InsertOutcome::Known
    );
    clock.forward(DAY_MS);
    assert_eq!(
        store.keep_window(second, &window(5)).unwrap(),
        InsertOutcome::Known
    );
    assert_eq!(store.figures().windows_known, 3);
    drop(store);
    let mut store = open();
    let third = session(&mut store);
    assert_eq!(
        store.keep_window(third, &window(5)).unwrap(),
        InsertOutcome::Known
    );
    // Another boot counts anew, and another device does.
    let device = store.device("bench", "usb:1").unwrap();
    let boot = store.begin_session(device, &hello(8), &FRONT_END).unwrap();
    assert_eq!(
        store.keep_window(boot, &window(5)).unwrap(),
        InsertOutcome::New
    );
    let device = store.device("kitchen", "usb:2").unwrap();
    let other = store.begin_session(device, &hello(7), &FRONT_END).unwrap();
    assert_eq!(
        store.keep_window(other, &window(5)).unwrap(),
        InsertOutcome::New
    );
    let rows = StoreReader::open(folder.path())
        .unwrap()
        .windows(&WindowFilter::default())
        .unwrap();
    let keys: Vec<_> = rows
        .iter()
        .map(|r| (r.device.as_str(), r.boot, r.seq))
        .collect();
    assert_eq!(keys, [("bench", 7, 5), ("bench", 8, 5), ("kitchen", 7, 5)]);
}

#[test]
fn of_windows_that_are_not_kept_there_is_a_row() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(
        folder.path(),
        &keeping(SamplePolicy::OneIn(3), 1 << 30, None),
    );
    let session = session(&mut store);
    for seq in 0..9 {
        // Every second one comes twice: a repetition is none of the three.
        store.keep_window(session, &window(seq)).unwrap();
        if seq % 2 == 0 {
            assert_eq!(
                store.keep_window(session, &window(seq)).unwrap(),
                InsertOutcome::Known
            );
        }
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    let rows = reader.windows(&WindowFilter::default()).unwrap();
    let kept: Vec<u32> = rows
        .iter()
        .filter(|r| r.not_kept.is_none())
        .map(|r| r.seq)
        .collect();
    assert_eq!((rows.len(), kept), (9, vec![0, 3, 6]));
    assert_eq!(rows[1].not_kept.as_deref(), Some("policy"));
    assert_eq!(
        (rows[1].half_cycle, rows[1].pairs, rows[1].packed_bytes),
        (27, 9_150, 0)
    );
    assert_eq!(reader.window("bench", 7, 1).unwrap(), None);
    assert_eq!(reader.window("bench", 7, 3).unwrap(), Some(window(3)));
    let figures = store.figures();
    assert_eq!((figures.windows, figures.not_kept_by_policy), (9, 6));
}

#[test]
fn samples_that_tell_nothing_go_when_the_verdict_comes() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let settings = keeping(SamplePolicy::Informative, 1 << 30, None);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    let session = session(&mut store);
    for seq in 0..5 {
        store.keep_window(session, &window(seq)).unwrap();
    }
    let verdict = |seq: u32, pass: bool, changed_lookup: bool| ihd_store::NewResult {
        pass,
        changed_lookup,
        ..result(session, seq)
    };
    store.record_result(&verdict(0, true, false), None).unwrap();
    store
        .record_result(&verdict(1, false, false), None)
        .unwrap();
    store.record_result(&verdict(2, true, true), None).unwrap();
    // A verdict after midnight is of a window of yesterday.
    clock.forward(DAY_MS / 2 + 1);
    store.keep_window(session, &window(5)).unwrap();
    store.record_result(&verdict(3, true, false), None).unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let there = |seq| reader.window("bench", 7, seq).unwrap().is_some();
    let have: Vec<u32> = (0..6).filter(|seq| there(*seq)).collect();
    assert_eq!(have, [1, 2, 4, 5]);
    assert_eq!(reader.windows(&WindowFilter::default()).unwrap().len(), 6);
    drop(store);
    // A process that ends between verdict and dropping leaves it to the next collection.
    let mut store = open(folder.path(), &keeping(SamplePolicy::All, 1 << 30, None));
    store.record_result(&verdict(5, true, false), None).unwrap();
    assert!(there(5));
    drop(store);
    let mut store = Store::open_with_clock(folder.path(), &settings, clock.clock())
        .unwrap()
        .store;
    store.keep_window(session, &window(6)).unwrap();
    assert_eq!(store.collect_garbage().unwrap().samples_dropped, 1);
    assert!(!there(5) && there(6));
}

#[test]
fn results_are_as_they_were_given_newest_first() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
    let mut store = opened.unwrap().store;
    let session = session(&mut store);
    for seq in 0..120 {
        clock.forward(1_000);
        store.record_result(&result(session, seq), None).unwrap();
    }
    let odd = ihd_store::NewResult {
        power_w: None,
        r_ohm: f64::NAN,
        sigma_l_pct: f64::INFINITY,
        pass: false,
        why: "a\u{1b}[31mb".to_owned(),
        ..result(session, u32::MAX)
    };
    clock.forward(1_000);
    let id = store.record_result(&odd, None).unwrap();
    let all = |filter: &ResultFilter| store.results(filter).unwrap();
    let first = all(&ResultFilter::default());
    assert_eq!(first.len(), 100);
    let row = &first[0];
    assert_eq!(
        (row.id, row.device.as_str(), row.boot, row.seq),
        (id, "bench", 7, u32::MAX)
    );
    assert_eq!(
        (row.session, row.at_ms, row.half_cycle),
        (session, NOON_MS + 121_000, odd.half_cycle)
    );
    assert!(row.r_ohm.is_nan() && row.sigma_l_pct.is_nan() && row.power_w.is_none());
    assert_eq!((row.pass, row.why.as_str()), (false, "a\\u{1b}[31mb"));
    assert_eq!(
        (first[1].seq, first[1].r_ohm, first[1].l_h),
        (119, 2.345, 8.125e-5)
    );
    assert_eq!(
        (first[1].power_w, first[1].i_crest_a, first[1].iterations),
        (Some(1_204.5), 31.25, 321)
    );
    let since = ResultFilter {
        since_ms: Some(NOON_MS + 119_000),
        device: Some("bench".into()),
        limit: None,
    };
    assert_eq!(
        all(&since).iter().map(|r| r.seq).collect::<Vec<_>>(),
        [u32::MAX, 119, 118]
    );
    let nobody = ResultFilter {
        device: Some("nobody".into()),
        ..ResultFilter::default()
    };
    assert_eq!(all(&nobody), []);
}

/// A worker's answer may come days after its window.
#[test]
fn a_result_has_the_time_of_its_window() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
    let mut store = opened.unwrap().store;
    let session = session(&mut store);
    for seq in 1..=3 {
        store.keep_window(session, &sized(seq, 300)).unwrap();
        clock.forward(DAY_MS);
    }
    // Of the last one there is no window: it has its own time.
    for seq in [2, 1, 3, 4] {
        store.record_result(&result(session, seq), None).unwrap();
    }
    let rows = store.results(&ResultFilter::default()).unwrap();
    let days = rows
        .iter()
        .map(|row| (row.seq, (row.at_ms - NOON_MS) / DAY_MS));
    assert!(days.eq([(4, 3), (3, 2), (2, 1), (1, 0)]), "{rows:?}");
}

#[test]
fn what_was_learned_of_a_board_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    let device = store.device("bench", "elsewhere").unwrap();
    store
        .record_result(&result(session, 1), Some(b"state"))
        .unwrap();
    store.adopt_lookup(device, &prior()).unwrap();
    // Whose it is was not known; then it is the same board's.
    for chip in ["0a", "0a"] {
        assert_eq!(store.set_chip(device, chip).unwrap(), None);
        assert!(store.learner_state(device).unwrap().is_some());
        assert!(store.lookup("bench", None).unwrap().is_some());
    }
    assert_eq!(store.set_chip(device, "0b").unwrap().as_deref(), Some("0a"));
    assert_eq!(store.learner_state(device).unwrap(), None);
    assert_eq!(store.lookup("bench", None).unwrap(), None, "none is active");
    assert_eq!(store.set_chip(device, "0b").unwrap(), None);
}

#[test]
fn result_and_what_was_learned_are_one_and_learning_again_replaces() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let session = session(&mut store);
    let device = store.device("bench", "elsewhere").unwrap();
    assert_eq!(store.learner_state(device).unwrap(), None);
    let first = store
        .record_result(&result(session, 1), Some(b"state 1"))
        .unwrap();
    assert_eq!(store.learner_state(device).unwrap().unwrap(), b"state 1");
    let again = ihd_store::NewResult {
        r_ohm: 3.0,
        ..result(session, 1)
    };
    assert_eq!(store.record_result(&again, None).unwrap(), first);
    assert_eq!(store.learner_state(device).unwrap().unwrap(), b"state 1");
    let rows = store.results(&ResultFilter::default()).unwrap();
    assert_eq!((rows.len(), rows[0].r_ohm), (1, 3.0));
    assert!(!store.reset_learning(device, &prior(), || false).unwrap());
    assert_eq!(store.learner_state(device).unwrap().unwrap(), b"state 1");
    assert_eq!(store.lookup("bench", None).unwrap(), None);
    assert!(store.reset_learning(device, &prior(), || true).unwrap());
    assert_eq!(store.learner_state(device).unwrap(), None);
    let active = store.lookup("bench", None).unwrap().unwrap();
    assert_eq!(active.version, 0);
    assert_eq!(store.results(&ResultFilter::default()).unwrap().len(), 1);
    // What its pots taught is its own.
    assert_eq!(store.alloys(device).unwrap(), None);
    for state in [b"[1]", b"[2]"] {
        store.keep_alloys(device, state).unwrap();
    }
    assert_eq!(store.alloys(device).unwrap().unwrap(), b"[2]");
    assert!(store.keep_alloys(99, b"[3]").is_err());
    // Of a session that there is not, nothing is stored.
    let nobodys = store.record_result(&result(99, 2), Some(b"state 2"));
    assert!(matches!(
        nobodys,
        Err(StoreError::NoSession { session: 99 })
    ));
    assert!(matches!(
        store.keep_window(99, &window(1)),
        Err(StoreError::NoSession { .. })
    ));
    assert!(matches!(
        store.end_session(99, ""),
        Err(StoreError::NoSession { .. })
    ));
    assert_eq!(store.learner_state(device).unwrap(), None);
}

#[test]
fn a_session_that_was_cut_off_ends_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let (cut, ended) = (session(&mut store), session(&mut store));
    store.end_session(ended, "unplugged").unwrap();
    drop(store);
    let _store = open(folder.path(), &StoreOptions::default());
    let reader = StoreReader::open(folder.path()).unwrap();
    let of = |id| reader.session(id).unwrap().unwrap();
    assert_eq!(of(ended).why.as_deref(), Some("unplugged"));
    let cut = of(cut);
    assert!(cut.ended_ms >= Some(cut.began_ms) && cut.why.unwrap().contains("cut off"));
    assert_eq!(
        (cut.device.as_str(), cut.boot, cut.build.as_str()),
        ("bench", 7, "ihd-firmware 0.1.0")
    );
}

#[test]
fn a_second_process_is_told_who_has_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path(), &StoreOptions::default());
    let second = Store::open(folder.path(), &StoreOptions::default())
        .err()
        .unwrap();
    let words = second.to_string();
    assert!(matches!(second, StoreError::InUse { .. }), "{words}");
    assert!(
        words.contains(&format!("(process {})", std::process::id())),
        "{words}"
    );
    drop(store);
    open(folder.path(), &StoreOptions::default());
}
