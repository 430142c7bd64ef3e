//! The lease of a device, and the power that was asked for under it.
//!
//! One name at a time holds the lease, for [`LEASE_S`] from when it was taken or renewed last. Each grant has an identity of its own
//! ([`LeaseId`]): a command can end the grant that it began, and no other.
//!
//! ```text
//!            take, begin_command                    ask
//!   free ─────────────────────────► held, no power ─────► held, with power
//!    ▲                                  │                    │ released, expired, void, taken by force
//!    │            switched_off          ▼                    ▼
//!    └───────────────────────────────── ◄──────────────── power that has to end ◄── off, which leaves the lease
//! ```
//!
//! An `off` needs no lease, and ends none: what was asked for before it may heat no more, whoever's it is ([`LeaseBook::off`]).
//!
//! Power is a part of the held lease, so that there is none without a holder. Where the lease ends first, what the device still heats
//! with is a debt ([`LeaseBook::must_end`]): it is switched off before anything else is asked of it.

use std::time::Duration;

use tokio::time::Instant;

use crate::model::Lease;

/// Duration of a lease that nobody renews, in seconds.
pub const LEASE_S: u64 = 10;

/// Identity of one grant, as it was between two `off`s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeaseId {
    grant: u64,
    /// `off`s that came before.
    offs: u64,
}

/// The lease of one device, with its power.
#[derive(Debug, Default)]
pub struct LeaseBook {
    held: Option<Held>,
    /// Power in watt that the device may still heat with, of a lease that is over.
    ending_w: u16,
    grants: u64,
    offs: u64,
}

#[derive(Debug)]
struct Held {
    grant: u64,
    holder: String,
    until: Instant,
    /// Power that was asked for under it, in watt.
    power_w: u16,
    /// Commands under way that use it.
    commands: u32,
    /// It was taken as such, or for a sweep: it outlives the commands that use it.
    is_kept: bool,
}

/// Lease of which the device has not the power.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// Its holder.
    pub holder: String,
    /// Power that was asked for under it, in watt.
    pub power_w: u16,
}

/// Change of holder that a grant made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It was free.
    New,
    /// It was the holder's own, and lasts anew.
    Renewed,
    /// It was somebody else's, by name.
    From(String),
}

/// Reason for which something cannot be done under a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LeaseOver {
    /// The lease is over.
    #[error("its lease was over before it could be carried out")]
    Ended,
    /// An `off` was asked for later.
    #[error("an `off` came before it could be carried out")]
    Off,
}

impl LeaseBook {
    /// Takes the lease until it is released or runs out, or renews it; with `force` from somebody else, too.
    ///
    /// # Errors
    /// The lease of the other, without `force`.
    pub fn take(&mut self, holder: &str, force: bool, now: Instant) -> Result<Taken, Lease> {
        let taken = self.grant(holder, force, now)?;
        if let Some(held) = &mut self.held {
            held.is_kept = true;
        }
        Ok(taken)
    }

    /// Takes or renews the lease for one command, which ends it with [`LeaseBook::end_command`].
    ///
    /// # Errors
    /// The lease of somebody else.
    pub fn begin_command(&mut self, holder: &str, now: Instant) -> Result<(LeaseId, Taken), Lease> {
        let taken = self.grant(holder, false, now)?;
        let id = LeaseId {
            grant: self.grants,
            offs: self.offs,
        };
        if let Some(held) = &mut self.held {
            held.commands += 1;
        }
        Ok((id, taken))
    }

    /// Ends a command. Returns `true` if the lease ended with it: no other command uses it, nobody took it as such, and nothing heats
    /// under it.
    pub fn end_command(&mut self, id: LeaseId) -> bool {
        let Some(held) = self.held.as_mut().filter(|held| held.grant == id.grant) else {
            return false;
        };
        held.commands = held.commands.saturating_sub(1);
        let ends = held.commands == 0 && !held.is_kept && held.power_w == 0;
        if ends {
            self.end();
        }
        ends
    }

    fn grant(&mut self, holder: &str, force: bool, now: Instant) -> Result<Taken, Lease> {
        let taken = match self.current(now) {
            None => Taken::New,
            Some(lease) if lease.holder == holder => Taken::Renewed,
            Some(lease) if force => Taken::From(lease.holder),
            Some(lease) => return Err(lease),
        };
        let until = now + Duration::from_secs(LEASE_S);
        if let (Taken::Renewed, Some(held)) = (&taken, &mut self.held) {
            held.until = until;
            return Ok(taken);
        }
        self.end();
        self.grants += 1;
        self.held = Some(Held {
            grant: self.grants,
            holder: holder.to_owned(),
            until,
            power_w: 0,
            commands: 0,
            is_kept: false,
        });
        Ok(taken)
    }

    /// Whatever was asked for under it has to end.
    fn end(&mut self) -> Option<String> {
        let held = self.held.take()?;
        self.ending_w = self.ending_w.max(held.power_w);
        Some(held.holder)
    }

    /// Gives the lease back; `true` if it was the holder's.
    pub fn release(&mut self, holder: &str) -> bool {
        let own = self.held.as_ref().is_some_and(|h| h.holder == holder);
        own && self.end().is_some()
    }

    /// The name whose lease has run out, once.
    pub fn expired(&mut self, now: Instant) -> Option<String> {
        match self.held.as_ref().is_some_and(|held| held.until <= now) {
            true => self.end(),
            false => None,
        }
    }

    /// Ends the lease, whoever has it: time has passed that no clock of ours has seen.
    pub fn void(&mut self) -> Option<String> {
        self.end()
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

    fn living(&mut self, id: LeaseId, now: Instant) -> Result<&mut Held, LeaseOver> {
        let held = self.held.as_mut();
        held.filter(|held| held.grant == id.grant && held.until > now)
            .ok_or(LeaseOver::Ended)
    }

    /// As [`LeaseBook::living`], for what is to heat.
    fn heating(&mut self, id: LeaseId, now: Instant) -> Result<&mut Held, LeaseOver> {
        let is_off = id.offs != self.offs;
        let held = self.living(id, now)?;
        match is_off {
            true => Err(LeaseOver::Off),
            false => Ok(held),
        }
    }

    /// Checks that this grant still lives.
    ///
    /// # Errors
    /// [`LeaseOver`].
    pub fn check(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseOver> {
        self.living(id, now).map(drop)
    }

    /// Checks that power may be asked for under this grant.
    ///
    /// # Errors
    /// [`LeaseOver`].
    pub fn may_heat(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseOver> {
        self.heating(id, now).map(drop)
    }

    /// Lets this grant outlive the command that began it, for what asks for power later.
    ///
    /// # Errors
    /// [`LeaseOver`].
    pub fn keep(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseOver> {
        self.heating(id, now)?.is_kept = true;
        Ok(())
    }

    /// Writes down that this power in watt is asked for under this grant. Returns what was asked for before.
    ///
    /// # Errors
    /// [`LeaseOver`]: nothing may be asked for.
    pub fn ask(&mut self, id: LeaseId, power_w: u16, now: Instant) -> Result<u16, LeaseOver> {
        let held = self.heating(id, now)?;
        Ok(std::mem::replace(&mut held.power_w, power_w))
    }

    /// `off` was asked for, by whomever: what was asked for before it may heat no more, and what the device heats with has to end.
    pub fn off(&mut self) {
        self.offs += 1;
        if let Some(held) = &mut self.held {
            self.ending_w = self.ending_w.max(std::mem::take(&mut held.power_w));
        }
    }

    /// Power in watt that was asked for and not taken back, under a lease or of one that is over.
    pub fn asked_w(&self) -> u16 {
        let held_w = self.held.as_ref().map_or(0, |held| held.power_w);
        held_w.max(self.ending_w)
    }

    /// Returns `true` if power was asked for that no living lease answers for: the device has to be switched off.
    pub fn must_end(&self, now: Instant) -> bool {
        self.ending_w > 0 || (self.asked_w() > 0 && self.current(now).is_none())
    }

    /// Returns `true` if a living lease has power, for which the device has to hear its host.
    pub fn heats(&self, now: Instant) -> bool {
        !self.must_end(now) && self.asked_w() > 0
    }

    /// Compares the lease with what the device says that it is asked for, in watt; a panel may hold it below. Where the device has
    /// something else than was asked for under the lease, the lease ends: returns it.
    pub fn device_has(&mut self, asked_w: u16, has_panel: bool) -> Option<Lost> {
        let power_w = self.held.as_ref()?.power_w;
        if power_w == 0 || asked_w == power_w || (has_panel && asked_w > 0) {
            return None;
        }
        let holder = self.end()?;
        if asked_w == 0 {
            self.ending_w = 0;
        }
        Some(Lost { holder, power_w })
    }

    /// The device has confirmed that it is off.
    pub fn switched_off(&mut self) {
        self.ending_w = 0;
        if let Some(held) = &mut self.held {
            held.power_w = 0;
        }
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
    fn power_that_the_device_has_not_ends_the_lease() {
        let now = Instant::now();
        // What the device says, whether a panel has a say, whether the lease ends, what is left to switch off.
        for (asked_w, has_panel, ends, left_w) in [
            (900, false, false, 900),
            (900, true, false, 900),
            (500, true, false, 900),
            (0, false, true, 0),
            (0, true, true, 0),
            // Somebody else asks it.
            (500, false, true, 900),
        ] {
            let mut book = LeaseBook::default();
            let (id, _) = book.begin_command("a", now).unwrap();
            assert_eq!(
                book.device_has(asked_w, has_panel),
                None,
                "it asks for nothing"
            );
            book.ask(id, 900, now).unwrap();
            let lost = book.device_has(asked_w, has_panel);
            let expected = ends.then(|| Lost {
                holder: "a".to_owned(),
                power_w: 900,
            });
            assert_eq!(lost, expected, "{asked_w} {has_panel}");
            assert_eq!(book.asked_w(), left_w, "{asked_w} {has_panel}");
            assert_eq!(book.must_end(now), ends && left_w > 0);
            assert_eq!(book.current(now).is_none(), ends);
        }
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

    /// Every order of two commands' beginnings, executions and ends, of one holder and of two: a device that was asked for power has
    /// a living lease or is to be switched off.
    #[test]
    fn no_order_of_two_commands_leaves_power_without_a_lease() {
        // Each command begins (0), is executed (1), ends (2); `heats` asks for power when executed.
        let orders = [
            [0, 0, 0, 1, 1, 1],
            [0, 0, 1, 0, 1, 1],
            [0, 0, 1, 1, 0, 1],
            [0, 0, 1, 1, 1, 0],
            [0, 1, 0, 0, 1, 1],
            [0, 1, 0, 1, 0, 1],
            [0, 1, 0, 1, 1, 0],
            [0, 1, 1, 0, 0, 1],
            [0, 1, 1, 0, 1, 0],
            [0, 1, 1, 1, 0, 0],
        ];
        let mut heated = 0;
        for order in orders {
            for case in 0..16 {
                let heats = [case & 1 > 0, case & 2 > 0];
                let holders = ["a", if case & 4 > 0 { "b" } else { "a" }];
                let refused = case & 8 > 0;
                let mut book = LeaseBook::default();
                let now = Instant::now();
                let (mut step, mut ids) = ([0; 2], [None; 2]);
                for which in order {
                    let id: Option<LeaseId> = ids[which];
                    match (step[which], id) {
                        (0, _) => {
                            let begun = book.begin_command(holders[which], now);
                            ids[which] = begun.ok().map(|(id, _)| id);
                        }
                        (1, Some(id)) if heats[which] => {
                            let before = book.ask(id, 1_000, now).unwrap();
                            if refused && which == 0 {
                                book.ask(id, before, now).unwrap();
                            }
                        }
                        (2, Some(id)) => drop(book.end_command(id)),
                        _ => {}
                    }
                    step[which] += 1;
                    let living = book.current(now).is_some();
                    assert!(book.asked_w() == 0 || living, "{order:?} {case}: {book:?}");
                    assert!(!book.must_end(now), "{order:?} {case}: {book:?}");
                }
                heated += u32::from(book.asked_w() > 0);
            }
        }
        assert!(heated > 40, "{heated}");
    }

    #[test]
    fn what_was_asked_for_before_an_off_heats_no_more_and_what_is_asked_for_later_does() {
        let now = Instant::now();
        let mut book = LeaseBook::default();
        let (heating, _) = book.begin_command("a", now).unwrap();
        assert_eq!(book.ask(heating, 700, now), Ok(0));
        let (waiting, _) = book.begin_command("a", now).unwrap();
        book.off();
        assert!(book.must_end(now) && !book.heats(now));
        for id in [heating, waiting] {
            assert_eq!(book.ask(id, 900, now), Err(LeaseOver::Off));
            assert_eq!(book.keep(id, now), Err(LeaseOver::Off));
            assert_eq!(
                book.check(id, now),
                Ok(()),
                "what heats nothing may be done"
            );
        }
        assert_eq!(book.asked_w(), 700);
        book.switched_off();
        assert_eq!((book.asked_w(), book.must_end(now)), (0, false));
        let lease = book.current(now).unwrap();
        assert_eq!(lease.holder, "a", "the lease is not what ended");
        let (later, _) = book.begin_command("a", now).unwrap();
        assert_eq!(book.ask(later, 900, now), Ok(0));
        assert!(book.heats(now));
        assert!(!book.end_command(waiting) && !book.end_command(later));
    }

    #[test]
    fn power_of_a_lease_that_is_over_has_to_end_and_none_can_be_asked_for_under_it() {
        let now = Instant::now();
        let late = now + Duration::from_secs(LEASE_S);
        for end in 0..5 {
            let mut book = LeaseBook::default();
            let (id, _) = book.begin_command("a", now).unwrap();
            assert_eq!(book.ask(id, 700, now), Ok(0));
            assert!(!book.end_command(id), "it heats");
            assert!(book.heats(now));
            let now = match end {
                0 => book.release("a").then_some(now),
                1 => book.expired(late).map(|_| late),
                2 => book.void().map(|_| now),
                3 => book.take("b", true, now).ok().map(|_| now),
                // Nobody has looked since.
                _ => Some(late),
            };
            let now = now.expect("it has ended");
            assert!(book.must_end(now) && !book.heats(now), "{end}: {book:?}");
            assert_eq!(book.ask(id, 900, now), Err(LeaseOver::Ended));
            assert_eq!(book.asked_w(), 700);
            book.switched_off();
            assert!(!book.must_end(now));
            assert_eq!(book.asked_w(), 0);
        }
    }
}
