//! Who may command a device.
//!
//! One name at a time holds the lease, for [`LEASE_S`] from when it was taken or renewed last. Power that was
//! asked for through the daemon belongs to one lease: when that is over, however it ends, the hob is switched
//! off. Whoever takes a lease over begins with a hob that is off.

use std::time::{Duration, Instant};

use crate::model::Lease;

/// How long a lease lasts unless it is renewed, in seconds.
pub const LEASE_S: u64 = 10;

/// The lease of one device.
#[derive(Debug, Default)]
pub struct LeaseBook {
    held: Option<Held>,
}

#[derive(Debug)]
struct Held {
    holder: String,
    until: Instant,
}

/// What taking a lease has changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It was free.
    New,
    /// It was the holder's own, and lasts anew.
    Renewed,
    /// It was somebody else's, by name.
    From(String),
}

impl LeaseBook {
    /// Takes the lease or renews it; with `force` from somebody else, too.
    ///
    /// # Errors
    /// The lease of the other, without `force`.
    pub fn take(&mut self, holder: &str, force: bool, now: Instant) -> Result<Taken, Lease> {
        let taken = match self.current(now) {
            None => Taken::New,
            Some(lease) if lease.holder == holder => Taken::Renewed,
            Some(lease) if force => Taken::From(lease.holder),
            Some(lease) => return Err(lease),
        };
        self.held = Some(Held {
            holder: holder.to_owned(),
            until: now + Duration::from_secs(LEASE_S),
        });
        Ok(taken)
    }

    /// Gives the lease back; whether it was the holder's.
    pub fn release(&mut self, holder: &str) -> bool {
        let own = self.held.as_ref().is_some_and(|h| h.holder == holder);
        if own {
            self.held = None;
        }
        own
    }

    /// The name whose lease has run out, once.
    pub fn expired(&mut self, now: Instant) -> Option<String> {
        self.held
            .take_if(|held| held.until <= now)
            .map(|held| held.holder)
    }

    /// Ends the lease, whoever has it: time has passed that no clock of ours has seen.
    pub fn void(&mut self) -> Option<String> {
        self.held.take().map(|held| held.holder)
    }

    /// The lease, where there is one.
    pub fn current(&self, now: Instant) -> Option<Lease> {
        let held = self.held.as_ref()?;
        let left = held.until.checked_duration_since(now)?;
        (!left.is_zero()).then(|| Lease {
            holder: held.holder.clone(),
            expires_in_s: left.as_secs_f64().ceil() as u32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_name_holds_it_until_it_runs_out() {
        let mut book = LeaseBook::default();
        let t0 = Instant::now();
        let at = |s: u64| t0 + Duration::from_secs(s);
        assert_eq!(book.take("a", false, t0), Ok(Taken::New));
        let other = book.take("b", false, at(3)).unwrap_err();
        assert_eq!((other.holder.as_str(), other.expires_in_s), ("a", 7));
        assert_eq!(book.take("a", false, at(8)), Ok(Taken::Renewed));
        assert_eq!(book.expired(at(17)), None);
        assert_eq!(book.expired(at(18)), Some("a".to_owned()));
        assert_eq!(book.expired(at(18)), None);
        assert_eq!(book.take("b", false, at(18)), Ok(Taken::New));
    }

    #[test]
    fn force_takes_it_from_somebody_by_name() {
        let mut book = LeaseBook::default();
        let now = Instant::now();
        book.take("a", false, now).unwrap();
        assert_eq!(book.take("b", true, now), Ok(Taken::From("a".to_owned())));
        assert!(!book.release("a"), "it is not theirs any more");
        assert!(book.release("b"));
        assert_eq!(book.current(now), None);
    }

    #[test]
    fn a_lease_that_ran_out_is_nobodys_before_anybody_has_noticed() {
        let mut book = LeaseBook::default();
        let now = Instant::now();
        book.take("a", false, now).unwrap();
        let later = now + Duration::from_secs(LEASE_S);
        assert_eq!(book.current(later), None);
        assert_eq!(book.take("b", false, later), Ok(Taken::New));
    }
}
