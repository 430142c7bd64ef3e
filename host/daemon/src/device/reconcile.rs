//! Reconciliation of the lookup on the device with those in the store.
//!
//! A lookup is pending in the store before it is pushed, and active once the device reports it. After an interruption
//! at any point, the next connection reconciles both sides:
//!
//! | on the device | in the store | step |
//! |---|---|---|
//! | the pending one | pending | it becomes active |
//! | the active one | active, and a newer one pending | the newer one is pushed again |
//! | the built-in one | active | the device has lost it: it is pushed again |
//! | another one | any | the device's is adopted; a pending one is not pushed |

use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_store::{LookupRow, LookupState, superseded_lookups};

/// Step that makes device and store agree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reconcile {
    /// No step: they agree.
    Nothing,
    /// Mark this pending version as active, because the device uses it.
    Activate(u32),
    /// Store the device's lookup as the active one.
    Adopt,
    /// Push this lookup to the device, for this reason.
    Push(Box<RlLookup>, &'static str),
}

/// Compares the device's lookup with its lookups in the store, oldest first. Returns the steps in order.
pub fn reconcile(on_device: &RlLookup, rows: &[LookupRow]) -> Vec<Reconcile> {
    let newest = |state| rows.iter().rev().find(|row| row.state == state);
    let (active, pending) = (newest(LookupState::Active), newest(LookupState::Pending));
    let bytes = on_device.to_bytes();
    let is_on_device = |row: &LookupRow| row.blob == bytes;
    let push_again = |row: &LookupRow, why| {
        // Checked when it was stored; if it is damaged since, it is not pushed.
        RlLookup::from_bytes(&row.blob)
            .ok()
            .map(|lookup| Reconcile::Push(Box::new(lookup), why))
    };
    match (active, pending) {
        (_, Some(pending)) if is_on_device(pending) => vec![Reconcile::Activate(pending.version)],
        (Some(active), pending) if is_on_device(active) => {
            let newer = pending.filter(|p| p.version > active.version);
            let pushed = newer.and_then(|p| push_again(p, "it was pending when the link was cut"));
            vec![pushed.unwrap_or(Reconcile::Nothing)]
        }
        (None, Some(pending)) if on_device.version == 0 => {
            let pushed = push_again(pending, "it was pending when the link was cut");
            std::iter::once(Reconcile::Adopt).chain(pushed).collect()
        }
        (Some(active), _) if on_device.version == 0 => {
            let pushed = push_again(active, "the device has lost it");
            vec![pushed.unwrap_or(Reconcile::Adopt)]
        }
        _ => vec![Reconcile::Adopt],
    }
}

/// Returns the version of a new lookup: above that of the device and, as far as the device would accept it, above all
/// of the store.
///
/// # Errors
/// Advice if the device's version is the largest.
pub fn next_version(on_device: u32, rows: &[LookupRow]) -> Result<u32, String> {
    let next = on_device.checked_add(1).ok_or_else(|| {
        format!(
            "its lookup has version {on_device}, above which there is none: `ihd device DEV lookup push builtin` begins anew"
        )
    })?;
    let highest = on_device.saturating_add(LOOKUP_VERSION_STEP);
    let used = rows
        .iter()
        .map(|row| row.version)
        .filter(|&v| v < highest)
        .max();
    Ok(next.max(used.map_or(0, |v| v + 1)))
}

/// Returns the newest lookup that was active before the present one; `None` if there is none.
pub fn previous_lookup(on_device: u32, rows: &[LookupRow]) -> Option<RlLookup> {
    superseded_lookups(rows, on_device).find_map(|row| RlLookup::from_bytes(&row.blob).ok())
}

#[cfg(test)]
mod tests {
    use ihd_shared::lookup::prior::prior;

    use super::*;

    fn lookup(version: u32) -> RlLookup {
        RlLookup { version, ..prior() }
    }

    fn row(version: u32, state: LookupState) -> LookupRow {
        LookupRow {
            device: "bench".to_owned(),
            version,
            state,
            origin: "host".to_owned(),
            at_ms: 0,
            why: String::new(),
            blob: lookup(version).to_bytes().to_vec(),
        }
    }

    #[test]
    fn whatever_was_cut_both_sides_come_together() {
        use LookupState::{Active, Pending, Refused, Superseded};
        let push = |v, why| Reconcile::Push(Box::new(lookup(v)), why);
        let (cut, lost) = (
            "it was pending when the link was cut",
            "the device has lost it",
        );
        for (on_device, rows, expected) in [
            // Nothing was ever learned: the built-in one is what the device uses.
            (0, vec![], vec![Reconcile::Adopt]),
            (0, vec![row(0, Active)], vec![Reconcile::Nothing]),
            // Killed between the push and the answer.
            (
                5,
                vec![row(4, Active), row(5, Pending)],
                vec![Reconcile::Activate(5)],
            ),
            // Killed between the store and the push.
            (4, vec![row(4, Active), row(5, Pending)], vec![push(5, cut)]),
            (
                0,
                vec![row(1, Pending)],
                vec![Reconcile::Adopt, push(1, cut)],
            ),
            (
                4,
                vec![row(4, Active), row(5, Refused)],
                vec![Reconcile::Nothing],
            ),
            // Flash erased.
            (
                0,
                vec![row(3, Superseded), row(4, Active)],
                vec![push(4, lost)],
            ),
            // Somebody else pushed.
            (
                9,
                vec![row(4, Active), row(5, Pending)],
                vec![Reconcile::Adopt],
            ),
            (
                3,
                vec![row(3, Superseded), row(4, Active)],
                vec![Reconcile::Adopt],
            ),
            (u32::MAX, vec![row(4, Active)], vec![Reconcile::Adopt]),
        ] {
            assert_eq!(
                reconcile(&lookup(on_device), &rows),
                expected,
                "{on_device}"
            );
        }
    }

    #[test]
    fn the_same_version_with_other_cells_is_another_lookup() {
        let mut other = lookup(4);
        other.mark_observed(1, 1);
        assert_eq!(
            reconcile(&other, &[row(4, LookupState::Active)]),
            [Reconcile::Adopt]
        );
    }

    #[test]
    fn a_version_is_new_to_both_and_one_that_the_device_takes() {
        let rows = |versions: &[u32]| -> Vec<_> {
            let of = |&v: &u32| row(v, LookupState::Superseded);
            versions.iter().map(of).collect()
        };
        assert_eq!(next_version(0, &[]), Ok(1));
        assert_eq!(next_version(4, &rows(&[3, 4, 7])), Ok(8));
        assert_eq!(
            next_version(0, &rows(&[5_000])),
            Ok(1),
            "beyond the device's step"
        );
        assert_eq!(next_version(0, &rows(&[999])), Ok(1_000));
        assert_eq!(next_version(0, &rows(&[1_000])), Ok(1));
        assert_eq!(next_version(u32::MAX - 1, &[]), Ok(u32::MAX));
        assert!(
            next_version(u32::MAX, &[])
                .unwrap_err()
                .contains("push builtin")
        );
    }

    #[test]
    fn rollback_goes_to_what_was_active_last() {
        use LookupState::{Active, Refused, Superseded};
        let rows = [
            row(2, Superseded),
            row(3, Superseded),
            row(4, Refused),
            row(5, Active),
        ];
        assert_eq!(previous_lookup(5, &rows).map(|l| l.version), Some(3));
        assert_eq!(previous_lookup(5, &[row(5, Active)]), None);
    }
}
