//! What a fleet has not got: kept with the window, over restarts and days, until it is answered.

use ihd_store::{Due, FleetState, Keep, Sent, Settings, Store};

use super::fixture::*;

fn numbers(store: &mut Store, limit: usize) -> Vec<u32> {
    let due = store.due(limit).unwrap();
    due.into_iter().map(|due| due.seq).collect()
}

#[test]
fn windows_are_due_in_their_order_until_the_fleet_has_them_over_restarts_and_days() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Settings::default();
    let clock = SetClock::at(NOON_MS - 2 * DAY_MS);
    let open = || {
        let opened = Store::open_with_clock(folder.path(), &settings, clock.clock());
        opened.unwrap().store
    };
    let mut store = open();
    let of = session(&mut store);
    // Of before the fleet: it gets none of these.
    store.keep_window(of, &window(1)).unwrap();
    for seq in 2..6 {
        clock.forward(DAY_MS / 2);
        let (_, due) = store.keep_window_for(of, &window(seq), true).unwrap();
        assert!(due);
    }
    assert_eq!(numbers(&mut store, 10), [2, 3, 4, 5]);
    assert_eq!(numbers(&mut store, 2), [2, 3]);
    drop(store);
    let mut store = open();
    assert_eq!(store.count_due().unwrap(), 4);
    let due = store.due(3).unwrap();
    // Without a result its samples, with one that.
    store.record_result(&result(of, 3), None).unwrap();
    let Due::Window(read) = store.read_due(&due[0]).unwrap() else {
        panic!("a window that nobody has identified");
    };
    assert_eq!(*read, window(2));
    assert!(matches!(store.read_due(&due[1]).unwrap(), Due::Result(row) if row.seq == 3));
    store
        .sent(&[
            (due[0].clone(), Sent::Window),
            (due[1].clone(), Sent::Result),
        ])
        .unwrap();
    assert_eq!(numbers(&mut store, 10), [4, 5]);
    let last = store.due(2).unwrap();
    store
        .sent(&[
            (last[0].clone(), Sent::Window),
            (last[1].clone(), Sent::Window),
        ])
        .unwrap();
    store.answered(&last[1].device, last[1].boot, 5).unwrap();
    assert_eq!(numbers(&mut store, 10), [] as [u32; 0]);
    // Sent, and never answered: 2 and 4, not 3 and 5. Only what is older than asked for.
    assert_eq!(store.due_again(last[0].at_ms).unwrap(), 1);
    assert_eq!(numbers(&mut store, 10), [2]);
    assert_eq!(store.due_again(i64::MAX).unwrap(), 1);
    assert_eq!(numbers(&mut store, 10), [2, 4]);
}

/// A daemon is started again on the day on which all windows were answered: what comes next is due at once, not from midnight on.
#[test]
fn a_store_that_owed_nothing_when_it_was_opened_owes_what_comes_next() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Settings::default();
    let clock = SetClock::at(NOON_MS);
    let open = || {
        let opened = Store::open_with_clock(folder.path(), &settings, clock.clock());
        opened.unwrap().store
    };
    let mut store = open();
    let of = session(&mut store);
    store.keep_window_for(of, &window(1), true).unwrap();
    let state = |store: &mut Store, seq| store.fleet_state("bench", 7, seq).unwrap();
    assert_eq!(state(&mut store, 1), Some(FleetState::Due));
    let due = store.due(1).unwrap().remove(0);
    store.sent(&[(due.clone(), Sent::Window)]).unwrap();
    assert_eq!(state(&mut store, 1), Some(FleetState::Sent));
    store.answered(&due.device, due.boot, due.seq).unwrap();
    assert_eq!(state(&mut store, 1), Some(FleetState::Answered));
    assert_eq!(state(&mut store, 2), None);
    drop(store);

    let mut store = open();
    let of = session(&mut store);
    assert_eq!(numbers(&mut store, 10), [] as [u32; 0]);
    store.keep_window_for(of, &window(2), true).unwrap();
    assert_eq!(numbers(&mut store, 10), [2]);
    assert_eq!(store.count_due().unwrap(), 1);
    // The clock of this machine was put back.
    clock.forward(-DAY_MS);
    store.keep_window_for(of, &window(3), true).unwrap();
    assert_eq!(numbers(&mut store, 10), [3, 2]);
}

#[test]
fn what_has_no_samples_is_not_due_and_retention_tells_what_the_fleet_never_got() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS - 3 * DAY_MS);
    let settings = keeping(Keep::OneIn(2), 1 << 30, Some(1));
    let opened = Store::open_with_clock(folder.path(), &settings, clock.clock());
    let mut store = opened.unwrap().store;
    let of = session(&mut store);
    let due: Vec<bool> = (0..4)
        .map(|seq| store.keep_window_for(of, &window(seq), true).unwrap().1)
        .collect();
    assert_eq!(due, [true, false, true, false]);
    assert_eq!(numbers(&mut store, 10), [0, 2]);
    store.collect_garbage().unwrap();
    live(&mut store, &clock, 2 * DAY_MS);
    assert_eq!(store.count_due().unwrap(), 0);
    let events = store.due_events(10).unwrap();
    assert!(events.is_empty(), "a fleet is told no history: {events:?}");
    let told = ihd_store::Reader::open(folder.path()).unwrap();
    let told = told.events(100).unwrap();
    let text = "2 windows of 2026-11-19 that the fleet had not got are deleted: retention";
    assert!(told.iter().any(|event| event.text == text), "{told:?}");
    store.event(None, "store", "later").unwrap();
    let events = store.due_events(10).unwrap();
    assert_eq!(events.len(), 1);
    store.events_sent(events[0].0).unwrap();
    assert!(store.due_events(10).unwrap().is_empty());
}

#[test]
fn a_store_has_one_secret() {
    let folder = tempfile::tempdir().unwrap();
    let secret = open(folder.path(), &Settings::default())
        .fleet_secret()
        .unwrap();
    let mut again = open(folder.path(), &Settings::default());
    assert_eq!(again.fleet_secret().unwrap(), secret);
    let other = tempfile::tempdir().unwrap();
    let mut other = open(other.path(), &Settings::default());
    assert_ne!(other.fleet_secret().unwrap(), secret);
    assert_ne!(secret[..8], secret[8..]);
}
