//! The lookup on the device and the one in the store: which of the two is right.
//!
//! A lookup is pending in the store before it is pushed, and active when the device says so. Whatever was cut
//! in between, a connection finds both sides again:
//!
//! | on the device | in the store | then |
//! |---|---|---|
//! | the pending one | pending | it is active |
//! | the active one | active, and a newer one pending | that one is pushed again |
//! | the built-in one | active | the device has lost it: it is pushed again |
//! | another one | whatever | the device's is adopted, and what was pending is not pushed |

use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_store::{LookupRow, LookupState};

/// What brings both sides together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Mend {
    /// They agree.
    Nothing,
    /// The device uses this version, which the store holds.
    Activate(u32),
    /// The store did not know that the device uses what it uses.
    Adopt,
    /// Push this one, under a version of its own; why.
    Push(Box<RlLookup>, &'static str),
}

/// Compares the lookup that a device uses with what the store holds of it, oldest first.
pub fn mend(on_device: &RlLookup, rows: &[LookupRow]) -> Vec<Mend> {
    let of = |state| rows.iter().rev().find(|row| row.state == state);
    let (active, pending) = (of(LookupState::Active), of(LookupState::Pending));
    let bytes = on_device.to_bytes();
    let is = |row: &LookupRow| row.blob == bytes;
    let again = |row: &LookupRow, why| {
        // What the store holds was checked when it went in; if it is broken, it is not pushed.
        RlLookup::from_bytes(&row.blob)
            .ok()
            .map(|lookup| Mend::Push(Box::new(lookup), why))
    };
    match (active, pending) {
        (_, Some(pending)) if is(pending) => vec![Mend::Activate(pending.version)],
        (Some(active), pending) if is(active) => {
            let newer = pending.filter(|p| p.version > active.version);
            let pushed = newer.and_then(|p| again(p, "it was pending when the link was cut"));
            vec![pushed.unwrap_or(Mend::Nothing)]
        }
        (None, Some(pending)) if on_device.version == 0 => {
            let pushed = again(pending, "it was pending when the link was cut");
            std::iter::once(Mend::Adopt).chain(pushed).collect()
        }
        (Some(active), _) if on_device.version == 0 => {
            let pushed = again(active, "the device has lost it");
            vec![pushed.unwrap_or(Mend::Adopt)]
        }
        _ => vec![Mend::Adopt],
    }
}

/// The version that a new lookup gets: above that of the device and, where the device would still take it,
/// above all of the store's.
///
/// # Errors
/// What to do where the device's leaves no room.
pub fn next_version(on_device: u32, rows: &[LookupRow]) -> Result<u32, String> {
    let next = on_device.checked_add(1).ok_or_else(|| {
        format!(
            "its lookup has version {on_device}, above which there is none: `ihd device DEV lookup reset` begins anew"
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

/// The lookup that was active before the present one, newest first.
pub fn before_this(on_device: u32, rows: &[LookupRow]) -> Option<RlLookup> {
    let superseded = rows.iter().rev();
    superseded
        .filter(|row| row.state == LookupState::Superseded && row.version != on_device)
        .find_map(|row| RlLookup::from_bytes(&row.blob).ok())
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
        let push = |v, why| Mend::Push(Box::new(lookup(v)), why);
        let (cut, lost) = (
            "it was pending when the link was cut",
            "the device has lost it",
        );
        for (on_device, rows, expected) in [
            // Nothing was ever learned: the built-in one is what the device uses.
            (0, vec![], vec![Mend::Adopt]),
            (0, vec![row(0, Active)], vec![Mend::Nothing]),
            // Killed between the push and the answer.
            (
                5,
                vec![row(4, Active), row(5, Pending)],
                vec![Mend::Activate(5)],
            ),
            // Killed between the store and the push.
            (4, vec![row(4, Active), row(5, Pending)], vec![push(5, cut)]),
            (0, vec![row(1, Pending)], vec![Mend::Adopt, push(1, cut)]),
            (
                4,
                vec![row(4, Active), row(5, Refused)],
                vec![Mend::Nothing],
            ),
            // Flash erased.
            (
                0,
                vec![row(3, Superseded), row(4, Active)],
                vec![push(4, lost)],
            ),
            // Somebody else pushed.
            (9, vec![row(4, Active), row(5, Pending)], vec![Mend::Adopt]),
            (
                3,
                vec![row(3, Superseded), row(4, Active)],
                vec![Mend::Adopt],
            ),
            (u32::MAX, vec![row(4, Active)], vec![Mend::Adopt]),
        ] {
            assert_eq!(mend(&lookup(on_device), &rows), expected, "{on_device}");
        }
    }

    #[test]
    fn the_same_version_with_other_cells_is_another_lookup() {
        let mut other = lookup(4);
        other.mark_observed(1, 1);
        assert_eq!(mend(&other, &[row(4, LookupState::Active)]), [Mend::Adopt]);
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
        assert!(next_version(u32::MAX, &[]).unwrap_err().contains("reset"));
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
        assert_eq!(before_this(5, &rows).map(|l| l.version), Some(3));
        assert_eq!(before_this(5, &[row(5, Active)]), None);
    }
}
