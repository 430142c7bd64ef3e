//! A lookup's states: at most one active, at most one pending, whatever is asked in whatever order.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{LookupState, Store, StoreError, StoreOptions, StoreReader};
use proptest::prelude::*;

use super::fixture::open;
use LookupState::{Active, Pending, Refused, Superseded};

fn lookup(version: u32) -> RlLookup {
    RlLookup { version, ..prior() }
}

fn states(store: &Store, device: i64) -> Vec<(u32, LookupState)> {
    let rows = store.lookups(device).unwrap();
    rows.iter().map(|row| (row.version, row.state)).collect()
}

#[test]
fn a_lookup_is_pending_then_active_then_superseded() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let device = store.device("a", "sim").unwrap();
    store
        .pend_lookup(device, &lookup(1), "5 new cells", None)
        .unwrap();
    assert_eq!(states(&store, device), [(1, Pending)]);
    store.adopt_lookup(device, &lookup(1)).unwrap();
    store.adopt_lookup(device, &lookup(1)).unwrap();
    store.pend_lookup(device, &lookup(2), "", None).unwrap();
    store
        .pend_lookup(device, &lookup(2), "once more", None)
        .unwrap();
    assert_eq!(states(&store, device), [(1, Active), (2, Pending)]);
    store.adopt_lookup(device, &lookup(2)).unwrap();
    assert_eq!(states(&store, device), [(1, Superseded), (2, Active)]);
    store.pend_lookup(device, &lookup(3), "", None).unwrap();
    store
        .refuse_lookup(device, 3, "cell 12 is out of range")
        .unwrap();
    store
        .refuse_lookup(device, 3, "cell 12 is out of range")
        .unwrap();
    assert_eq!(
        states(&store, device),
        [(1, Superseded), (2, Active), (3, Refused)]
    );
    let rows = store.lookups(device).unwrap();
    assert_eq!(
        (rows[0].why.as_str(), rows[2].why.as_str()),
        ("5 new cells", "cell 12 is out of range")
    );
    assert_eq!(RlLookup::from_bytes(&rows[1].blob), Ok(lookup(2)));
    assert!(
        rows.iter()
            .all(|row| row.origin == "host" && row.device == "a")
    );
}

#[test]
fn what_does_not_fit_the_states_is_said_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let device = store.device("a", "sim").unwrap();
    assert!(matches!(
        store.refuse_lookup(device, 4, ""),
        Err(StoreError::NoLookup { version: 4 })
    ));
    store.pend_lookup(device, &lookup(1), "", None).unwrap();
    store.adopt_lookup(device, &lookup(1)).unwrap();
    let refused = store.refuse_lookup(device, 1, "no");
    assert!(matches!(
        refused,
        Err(StoreError::LookupState { state: Active, .. })
    ));
    assert_eq!(states(&store, device), [(1, Active)]);
    assert!(
        store.pend_lookup(device + 1, &lookup(1), "", None).is_err(),
        "no such device"
    );
}

/// After a crash between push and answer, and after a reset of the device's versions.
#[test]
fn what_the_device_uses_is_active() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let device = store.device("a", "sim").unwrap();
    store.pend_lookup(device, &lookup(1), "", None).unwrap();
    store.adopt_lookup(device, &lookup(1)).unwrap();
    assert_eq!(states(&store, device), [(1, Active)]);
    // Superseded while the answer was lost; the device has it all the same.
    store.pend_lookup(device, &lookup(2), "", None).unwrap();
    store.pend_lookup(device, &lookup(3), "", None).unwrap();
    store.adopt_lookup(device, &lookup(2)).unwrap();
    assert_eq!(
        states(&store, device),
        [(1, Superseded), (2, Active), (3, Pending)]
    );
    // Reset: the prior is the device's own, and versions begin anew.
    store.adopt_lookup(device, &lookup(0)).unwrap();
    let mut other = lookup(1);
    other.mark_observed(2, 3);
    store.pend_lookup(device, &other, "", None).unwrap();
    store.adopt_lookup(device, &other).unwrap();
    let rows = store.lookups(device).unwrap();
    let active: Vec<_> = rows.iter().filter(|row| row.state == Active).collect();
    assert_eq!(
        (active.len(), &active[0].blob[..]),
        (1, &other.to_bytes()[..])
    );
    assert_eq!(
        rows.iter().find(|row| row.version == 0).unwrap().origin,
        "device"
    );
}

/// Each push leaves a row: a hob that learns for years neither fills the store nor makes a list of all of them.
#[test]
fn old_lookups_are_deleted_but_never_the_one_in_use_nor_the_pending_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let [a, b] = ["a", "b"].map(|name| store.device(name, "sim").unwrap());
    let past = 320;
    for device in [a, b] {
        // The one in use is the oldest row of all.
        store.adopt_lookup(device, &lookup(0)).unwrap();
        for version in 1..=past {
            store
                .pend_lookup(device, &lookup(version), "", None)
                .unwrap();
        }
        store.refuse_lookup(device, past, "no").unwrap();
        store
            .pend_lookup(device, &lookup(past + 1), "", None)
            .unwrap();
    }
    let kept = states(&store, a);
    assert_eq!(kept.len(), 302, "listed before they are deleted");
    assert_eq!(store.collect_garbage().unwrap().rows, 2 * 20);
    let reader = StoreReader::open(folder.path()).unwrap();
    assert_eq!(reader.lookups().unwrap().len(), 2 * 302);
    for device in [a, b] {
        assert_eq!(states(&store, device), kept);
    }
    for (name, device) in [("a", a), ("b", b)] {
        assert_eq!(
            reader.lookups_of(name).unwrap(),
            store.lookups(device).unwrap()
        );
    }
    let ends = (kept[0], kept[1], kept[300], kept[301]);
    let superseded = (past - 299, Superseded);
    assert_eq!(
        ends,
        (
            (0, Active),
            superseded,
            (past, Refused),
            (past + 1, Pending)
        )
    );
    let version = |asked| reader.lookup("b", asked).unwrap().map(|row| row.version);
    assert_eq!(version(None), Some(0));
    assert_eq!(version(Some(past)), Some(past));
    assert_eq!(version(Some(1)), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn never_two_active_nor_two_pending(
        asked in prop::collection::vec((0..3u8, 0..2u8, 0..5u32), 1..30)
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), &StoreOptions::default());
        let devices = [store.device("a", "").unwrap(), store.device("b", "").unwrap()];
        for (what, device, version) in asked {
            let device = devices[usize::from(device)];
            let before = states(&store, device);
            let done = match what {
                0 => store.pend_lookup(device, &lookup(version), "", None),
                1 => store.refuse_lookup(device, version, ""),
                _ => store.adopt_lookup(device, &lookup(version)),
            };
            let after = states(&store, device);
            if done.is_err() {
                prop_assert_eq!(&after, &before);
            }
            for state in [Active, Pending] {
                let count = after.iter().filter(|(_, s)| *s == state).count();
                prop_assert!(count <= 1, "{count} are {state}");
            }
            if what == 2 && done.is_ok() {
                prop_assert!(after.contains(&(version, Active)));
            }
        }
    }
}
