//! Windows that a fleet has not received: marked in the store, over restarts and days, until they are answered.

use ihd_model::FleetStates;
use ihd_store::{
    DeliveryState, FleetMark, FleetState, GiveUpReason, OutboxItem, SamplePolicy, Store,
    StoreOptions,
};

use super::fixture::*;

fn numbers(store: &mut Store, limit: usize) -> Vec<u32> {
    let due = store.due(None, limit).unwrap();
    due.into_iter().map(|due| due.seq).collect()
}

#[test]
fn windows_are_due_in_their_order_until_the_fleet_has_them_over_restarts_and_days() {
    let folder = tempfile::tempdir().unwrap();
    let settings = StoreOptions::default();
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
    let due = store.due(None, 3).unwrap();
    // Without a result its samples, with one that.
    store.record_result(&result(of, 3), None).unwrap();
    let OutboxItem::Window(read) = store.read_due(&due[0]).unwrap() else {
        panic!("a window that nobody has identified");
    };
    assert_eq!(*read, window(2));
    assert!(matches!(store.read_due(&due[1]).unwrap(), OutboxItem::Result(row) if row.seq == 3));
    store
        .mark_sent(&[
            (due[0].clone(), DeliveryState::Window),
            (due[1].clone(), DeliveryState::Result),
        ])
        .unwrap();
    assert_eq!(numbers(&mut store, 10), [4, 5]);
    let last = store.due(None, 2).unwrap();
    store
        .mark_sent(&[
            (last[0].clone(), DeliveryState::Window),
            (last[1].clone(), DeliveryState::Window),
        ])
        .unwrap();
    store
        .mark_answered(&last[1].device, last[1].boot, 5)
        .unwrap();
    assert_eq!(numbers(&mut store, 10), [] as [u32; 0]);
    // Sent, and never answered: 2 and 4, not 3 and 5. Only what was sent, not stored, before the time that is asked for.
    let now_ms = clock.clock();
    assert_eq!(store.requeue_unanswered(now_ms()).unwrap(), 0);
    clock.forward(1);
    let sent = store.unanswered(now_ms(), 0, 10).unwrap();
    assert_eq!(sent, [due[0].clone(), last[0].clone()]);
    assert_eq!(store.unanswered(now_ms(), 1, 10).unwrap(), sent[1..]);
    assert_eq!(store.unanswered(now_ms(), 0, 1).unwrap(), sent[..1]);
    // A clock that was put back has not made them younger.
    clock.forward(-DAY_MS / 2);
    assert_eq!(store.unanswered(now_ms() - 1, 0, 10).unwrap(), sent);
    assert_eq!(store.requeue_unanswered(now_ms() - 1).unwrap(), 2);
    assert_eq!(numbers(&mut store, 10), [2, 4]);
    assert_eq!(store.unanswered(i64::MAX, 0, 10).unwrap(), []);
}

/// A hob that was renamed, and that has its name again later.
#[test]
fn windows_of_other_devices_are_passed_over_and_stay_due() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS - 2 * DAY_MS);
    let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
    let mut store = opened.unwrap().store;
    let gone = store.device("gone", "sim").unwrap();
    let gone = store.begin_session(gone, &hello(7), &FRONT_END).unwrap();
    store.keep_window_for(gone, &window(1), true).unwrap();
    clock.forward(DAY_MS);
    let of = session(&mut store);
    store.keep_window_for(of, &window(2), true).unwrap();
    let due_of = |device: &str, store: &mut Store| {
        let due = store.due(Some(&[device.to_owned()]), 1).unwrap();
        due.into_iter().map(|due| due.seq).collect::<Vec<_>>()
    };
    assert_eq!(due_of("bench", &mut store), [2]);
    let due = store.due(None, 2).unwrap();
    let ends = [(due[1].clone(), DeliveryState::Damaged)];
    store.mark_sent(&ends).unwrap();
    assert_eq!(
        store.fleet_state("bench", 7, 2).unwrap(),
        Some(FleetState::GivenUp(GiveUpReason::Dead))
    );
    assert!(due_of("bench", &mut store).is_empty());
    assert_eq!(due_of("gone", &mut store), [1]);
}

fn tally(store: &mut Store) -> FleetStates {
    let days = store.days_of_windows().unwrap();
    let of = |day: &String| store.fleet_tally(day).unwrap();
    days.iter()
        .map(of)
        .fold(FleetStates::default(), FleetStates::and)
}

/// Each window is in one state, and together the states are what is stored: after every step.
#[test]
fn states_add_up_to_the_windows_stored() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS - DAY_MS);
    let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
    let mut store = opened.unwrap().store;
    let of = session(&mut store);
    let state = |store: &mut Store, seq| store.fleet_state("bench", 7, seq).unwrap().unwrap();
    store.keep_window(of, &window(0)).unwrap();
    for seq in 1..8 {
        if seq == 4 {
            clock.forward(DAY_MS);
        }
        store.keep_window_for(of, &window(seq), true).unwrap();
        assert_eq!(tally(&mut store).stored(), u64::from(seq) + 1);
    }
    let kept_ms = NOON_MS - DAY_MS;
    assert_eq!(tally(&mut store).due_since_ms, Some(kept_ms));
    let due = store.due(None, 10).unwrap();
    clock.forward(1_000);
    let ends = [
        DeliveryState::Result,
        DeliveryState::Nothing,
        DeliveryState::Window,
        DeliveryState::Window,
        DeliveryState::Window,
        DeliveryState::Window,
    ];
    let sent: Vec<_> = due.into_iter().zip(ends).collect();
    store.mark_sent(&sent).unwrap();
    store.mark_answered("bench", 7, 3).unwrap();
    store
        .mark_given_up("bench", 7, 4, "no worker could")
        .unwrap();
    store
        .mark_given_up("bench", 7, 5, "no worker could")
        .unwrap();
    // Somebody replayed it. What has ended otherwise stays as it is.
    store.mark_answered("bench", 7, 5).unwrap();
    store.mark_answered("bench", 7, 1).unwrap();
    store.mark_given_up("bench", 7, 3, "too late").unwrap();
    let expected = FleetStates {
        not_for_fleet: 1,
        due: 1,
        sent: 1,
        answered: 2,
        learned_here: 1,
        no_samples: 1,
        dead: 1,
        due_since_ms: Some(NOON_MS),
        sent_since_ms: Some(NOON_MS + 1_000),
    };
    assert_eq!(tally(&mut store), expected);
    let states: Vec<_> = (0..8).map(|seq| state(&mut store, seq)).collect();
    let expected = [
        FleetState::NotForFleet,
        FleetState::LearnedHere,
        FleetState::GivenUp(GiveUpReason::NoSamples),
        FleetState::Answered,
        FleetState::GivenUp(GiveUpReason::Dead),
        FleetState::Answered,
        FleetState::Sent,
        FleetState::Due,
    ];
    assert_eq!(states, expected);
    store.requeue_unanswered(i64::MAX).unwrap();
    let now = tally(&mut store);
    assert_eq!((now.due, now.sent, now.stored()), (2, 0, 8));
    // Its own result came back before the acknowledgement.
    store.mark_answered("bench", 7, 7).unwrap();
    assert_eq!(state(&mut store, 7), FleetState::LearnedHere);
}

/// Version 4 knew 0, 1 and 2 alone, and not since when.
#[test]
fn a_day_of_an_earlier_ihd_keeps_its_progress() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let open = || {
        let opened = Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock());
        opened.unwrap().store
    };
    let mut store = open();
    let of = session(&mut store);
    store.keep_window(of, &window(0)).unwrap();
    for seq in 1..4 {
        store.keep_window_for(of, &window(seq), true).unwrap();
    }
    drop(store);
    let files = files(folder.path()).into_iter();
    let day = files.filter(|f| f.starts_with("windows-") && f.ends_with(".db"));
    for day in day {
        let day = rusqlite::Connection::open(folder.path().join(day)).unwrap();
        let sql = "DROP INDEX windows_at_fleet; ALTER TABLE windows DROP COLUMN fleet_end;
            ALTER TABLE windows DROP COLUMN fleet_ms;
            CREATE INDEX windows_unanswered ON windows (at_ms) WHERE fleet = 1;
            UPDATE windows SET fleet = seq - 1 WHERE seq > 0;";
        day.execute_batch(sql).unwrap();
        day.pragma_update(None, "user_version", 4).unwrap();
    }
    let mut store = open();
    let expected = FleetStates {
        not_for_fleet: 1,
        due: 1,
        sent: 1,
        answered: 1,
        due_since_ms: Some(NOON_MS),
        sent_since_ms: Some(NOON_MS),
        ..FleetStates::default()
    };
    assert_eq!(tally(&mut store), expected);
    assert_eq!(store.requeue_unanswered(NOON_MS + 1).unwrap(), 1);
    assert_eq!(numbers(&mut store, 10), [1, 2]);
}

#[test]
fn what_is_known_of_a_server_is_remembered() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let made = FleetMark::ConsumerMade;
    assert_eq!(store.fleet_mark(made).unwrap(), None);
    store.mark_fleet(made, 1).unwrap();
    store.mark_fleet(FleetMark::LastWindow, 7).unwrap();
    store.mark_fleet(made, 2).unwrap();
    drop(store);
    let store = open(folder.path(), &StoreOptions::default());
    let marks = [made, FleetMark::LastWindow].map(|mark| store.fleet_mark(mark).unwrap());
    assert_eq!(marks, [Some(2), Some(7)]);
}

/// A daemon is started again on the day on which all windows were answered: what comes next is due at once, not from midnight on.
#[test]
fn a_store_that_owed_nothing_when_it_was_opened_owes_what_comes_next() {
    let folder = tempfile::tempdir().unwrap();
    let settings = StoreOptions::default();
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
    let due = store.due(None, 1).unwrap().remove(0);
    store
        .mark_sent(&[(due.clone(), DeliveryState::Window)])
        .unwrap();
    assert_eq!(state(&mut store, 1), Some(FleetState::Sent));
    store.mark_answered(&due.device, due.boot, due.seq).unwrap();
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
    let settings = keeping(SamplePolicy::OneIn(2), 1 << 30, Some(1));
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
    let (events, _) = store.due_events(None, 10).unwrap();
    assert!(events.is_empty(), "a fleet is told no history: {events:?}");
    let told = ihd_store::StoreReader::open(folder.path()).unwrap();
    let told = told.events(100).unwrap();
    let text = "2 windows of 2026-11-19 that the fleet had not answered are deleted: retention";
    assert!(told.iter().any(|event| event.text == text), "{told:?}");
    store.event(None, "store", "later").unwrap();
    let (events, up_to) = store.due_events(None, 10).unwrap();
    assert_eq!((events.len(), events[0].0), (1, up_to));
    store.mark_events_sent(&[], Some(up_to)).unwrap();
    assert!(store.due_events(None, 10).unwrap().0.is_empty());
}

/// One hob's events are acknowledged, another's are not.
#[test]
fn events_of_one_hob_wait_for_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    store.due_events(None, 1).unwrap();
    let hobs = ["aaa", "test"].map(str::to_owned);
    for hob in &hobs {
        let id = store.device(hob, "serial:/dev/null").unwrap();
        for text in ["first", "second"] {
            store.event(Some(id), "state", text).unwrap();
        }
    }
    let due = |store: &mut Store, hobs: &[String]| {
        let (events, up_to) = store.due_events(Some(hobs), 10).unwrap();
        (
            events.into_iter().map(|(n, _)| n).collect::<Vec<i64>>(),
            up_to,
        )
    };
    let (all, up_to) = due(&mut store, &hobs);
    assert_eq!((all.len(), all[3]), (4, up_to));
    assert_eq!(due(&mut store, &hobs[1..]).0, all[2..]);
    store
        .mark_events_sent(&[("test".to_owned(), all[3])], None)
        .unwrap();
    assert_eq!(due(&mut store, &hobs[1..]).0, [0; 0]);
    assert_eq!(due(&mut store, &hobs).0, all[..2]);
    store.mark_events_sent(&[], Some(up_to)).unwrap();
    assert_eq!(due(&mut store, &hobs).0, [0; 0]);
}

#[test]
fn a_store_has_one_secret() {
    let folder = tempfile::tempdir().unwrap();
    let secret = open(folder.path(), &StoreOptions::default())
        .fleet_secret()
        .unwrap();
    let mut again = open(folder.path(), &StoreOptions::default());
    assert_eq!(again.fleet_secret().unwrap(), secret);
    let other = tempfile::tempdir().unwrap();
    let mut other = open(other.path(), &StoreOptions::default());
    assert_ne!(other.fleet_secret().unwrap(), secret);
    assert_ne!(secret[..8], secret[8..]);
}
