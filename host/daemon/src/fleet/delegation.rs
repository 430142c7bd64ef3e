//! Delegation of windows to a fleet, limited in time.

use std::collections::BTreeSet;
use std::sync::Mutex;
use std::time::Duration;

use tokio::time::Instant;

use crate::locking::lock;

/// Duration of the delegation after the fleet's last sign of life: the longest that a result may take.
pub const DELEGATION_TIME: Duration = Duration::from_secs(20);

/// Delegation of windows to a fleet. It expires unless it is renewed, even if the renewing task has ended.
#[derive(Debug, Default)]
pub struct Delegation {
    /// `true` if the daemon is an edge of a fleet.
    pub is_edge: bool,
    until: Mutex<Option<Instant>>,
    /// Hobs whose windows are identified here all the same.
    except: Mutex<BTreeSet<String>>,
}

impl Delegation {
    /// Creates the delegation, not granted yet.
    pub fn new(is_edge: bool) -> Self {
        Self {
            is_edge,
            until: Mutex::new(None),
            except: Mutex::default(),
        }
    }

    /// Returns `true` while windows are left to the fleet.
    pub fn is_delegated(&self) -> bool {
        lock(&self.until).is_some_and(|until| Instant::now() < until)
    }

    /// Returns `true` while windows of this hob are left to the fleet.
    pub fn is_delegated_of(&self, hob: &str) -> bool {
        self.is_delegated() && !lock(&self.except).contains(hob)
    }

    /// Replaces the hobs whose windows are identified here all the same.
    pub(super) fn except(&self, hobs: BTreeSet<String>) {
        *lock(&self.except) = hobs;
    }

    /// Delegates until a time, at most [`DELEGATION_TIME`] from now; ends the delegation if `until` is `None`.
    pub(super) fn renew(&self, until: Option<Instant>) {
        let longest = Instant::now() + DELEGATION_TIME;
        *lock(&self.until) = until.map(|until| until.min(longest));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_delegation_expires_and_is_limited() {
        let delegation = Delegation::new(true);
        assert!(!delegation.is_delegated());
        delegation.renew(Some(Instant::now() + 100 * DELEGATION_TIME));
        assert!(delegation.is_delegated());
        delegation.except(["aaa".to_owned()].into());
        let of = ["aaa", "test"].map(|hob| delegation.is_delegated_of(hob));
        assert_eq!(of, [false, true]);
        tokio::time::advance(DELEGATION_TIME - Duration::from_millis(1)).await;
        assert!(delegation.is_delegated());
        tokio::time::advance(Duration::from_millis(1)).await;
        assert!(!delegation.is_delegated(), "not renewed");
        delegation.renew(Some(Instant::now() + Duration::from_secs(1)));
        assert!(delegation.is_delegated());
        delegation.renew(None);
        assert!(!delegation.is_delegated());
    }
}
