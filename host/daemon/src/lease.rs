//! The lease of a device, and the power requested under it.
//!
//! One holder at a time has the lease, for [`LEASE_S`] after it was taken or renewed. Each grant has its own [`LeaseId`]: a command
//! can end only the grant that it began.
//!
//! ```text
//!            take, begin_command                request_power
//!   free ─────────────────────────► held, no power ─────► held, with power
//!    ▲                                  │                    │ released, expired, revoked, taken by force
//!    │            confirm_off           ▼                    ▼
//!    └───────────────────────────────── ◄──────────────── power to switch off ◄── off, which keeps the lease
//! ```
//!
//! An `off` needs no lease and ends none: it cancels every earlier power request, of any holder ([`LeaseBook::off`]).
//!
//! Power is a part of the held lease, so there is none without a holder. If the lease ends first, its power remains to be switched
//! off ([`LeaseBook::must_switch_off`]), before any other request to the device.

use std::time::Duration;

use ihd_model::Lease;
use tokio::time::Instant;

/// Duration of a lease without renewal, in seconds.
pub const LEASE_S: u64 = 10;

/// Identity of one grant between two `off`s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeaseId {
    grant: u64,
    /// Number of `off`s before it.
    offs: u64,
}

/// Lease of one device, with its power.
#[derive(Debug, Default)]
pub struct LeaseBook {
    held: Option<ActiveLease>,
    /// Power of an ended lease that the device may still heat with, in watt.
    ending_w: u16,
    /// `true` while an `off` is not confirmed, whoever requested the power.
    is_off_due: bool,
    grants: u64,
    offs: u64,
}

#[derive(Debug)]
struct ActiveLease {
    grant: u64,
    holder: String,
    until: Instant,
    /// Power requested under it, in watt.
    power_w: u16,
    /// Commands under way that use it.
    commands: u32,
    /// `true` if it outlives its commands: taken explicitly, or for a sweep.
    is_kept: bool,
}

/// Lease that ended because the device has another power.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LostLease {
    /// Name of the holder.
    pub holder: String,
    /// Power requested under it, in watt.
    pub power_w: u16,
}

/// Change of holder by a grant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LeaseGrant {
    /// The lease was free.
    New,
    /// The holder had it already; its time restarts.
    Renewed,
    /// Taken from another holder, by name.
    From(String),
}

/// Reason that a lease does not permit a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LeaseError {
    /// The lease has ended.
    #[error("its lease was over before it could be carried out")]
    Ended,
    /// An `off` came after the grant.
    #[error("an `off` came before it could be carried out")]
    Off,
}

impl LeaseBook {
    /// Takes the lease until it is released or expires, or renews it; with `force` also from another holder.
    ///
    /// # Errors
    /// The lease of the other holder, without `force`.
    pub fn take(&mut self, holder: &str, force: bool, now: Instant) -> Result<LeaseGrant, Lease> {
        let taken = self.grant(holder, force, now)?;
        if let Some(held) = &mut self.held {
            held.is_kept = true;
        }
        Ok(taken)
    }

    /// Takes or renews the lease for one command, which ends it with [`LeaseBook::end_command`].
    ///
    /// # Errors
    /// The lease of the other holder.
    pub fn begin_command(
        &mut self,
        holder: &str,
        now: Instant,
    ) -> Result<(LeaseId, LeaseGrant), Lease> {
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

    /// Ends a command. Returns `true` if the lease ended with it: no other command uses it, it was not taken explicitly, and it has no
    /// power.
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

    fn grant(&mut self, holder: &str, force: bool, now: Instant) -> Result<LeaseGrant, Lease> {
        let taken = match self.current(now) {
            None => LeaseGrant::New,
            Some(lease) if lease.holder == holder => LeaseGrant::Renewed,
            Some(lease) if force => LeaseGrant::From(lease.holder),
            Some(lease) => return Err(lease),
        };
        let until = now + Duration::from_secs(LEASE_S);
        if let (LeaseGrant::Renewed, Some(held)) = (&taken, &mut self.held) {
            held.until = until;
            return Ok(taken);
        }
        self.end();
        self.grants += 1;
        self.held = Some(ActiveLease {
            grant: self.grants,
            holder: holder.to_owned(),
            until,
            power_w: 0,
            commands: 0,
            is_kept: false,
        });
        Ok(taken)
    }

    /// Ends the lease; its power remains to be switched off. Returns the holder.
    fn end(&mut self) -> Option<String> {
        let held = self.held.take()?;
        self.ending_w = self.ending_w.max(held.power_w);
        Some(held.holder)
    }

    /// Releases the lease. Returns `true` if `holder` had it.
    pub fn release(&mut self, holder: &str) -> bool {
        let own = self.held.as_ref().is_some_and(|h| h.holder == holder);
        own && self.end().is_some()
    }

    /// Ends an expired lease and returns its holder, once.
    pub fn expired(&mut self, now: Instant) -> Option<String> {
        match self.held.as_ref().is_some_and(|held| held.until <= now) {
            true => self.end(),
            false => None,
        }
    }

    /// Ends the lease of any holder, after time in which this process did not run. Returns the holder.
    pub fn revoke(&mut self) -> Option<String> {
        self.end()
    }

    /// Returns the lease; `None` if there is none or it has expired.
    pub fn current(&self, now: Instant) -> Option<Lease> {
        let held = self.held.as_ref()?;
        let left = held.until.checked_duration_since(now)?;
        (!left.is_zero()).then(|| Lease {
            holder: held.holder.clone(),
            expires_in_s: left.as_secs_f64().ceil() as u32,
        })
    }

    /// Returns the lease of a grant that has not ended or expired.
    fn living(&mut self, id: LeaseId, now: Instant) -> Result<&mut ActiveLease, LeaseError> {
        let held = self.held.as_mut();
        held.filter(|held| held.grant == id.grant && held.until > now)
            .ok_or(LeaseError::Ended)
    }

    /// Returns the lease of a grant that has not ended and that no `off` has followed.
    fn heating(&mut self, id: LeaseId, now: Instant) -> Result<&mut ActiveLease, LeaseError> {
        let is_off = id.offs != self.offs;
        let held = self.living(id, now)?;
        match is_off {
            true => Err(LeaseError::Off),
            false => Ok(held),
        }
    }

    /// Checks that this grant has not ended.
    ///
    /// # Errors
    /// [`LeaseError`].
    pub fn check(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseError> {
        self.living(id, now).map(drop)
    }

    /// Checks that power may be requested under this grant.
    ///
    /// # Errors
    /// [`LeaseError`].
    pub fn check_heating(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseError> {
        self.heating(id, now).map(drop)
    }

    /// Keeps this grant beyond the command that began it, for later power requests.
    ///
    /// # Errors
    /// [`LeaseError`].
    pub fn keep_after_command(&mut self, id: LeaseId, now: Instant) -> Result<(), LeaseError> {
        self.heating(id, now)?.is_kept = true;
        Ok(())
    }

    /// Records a power request in watt under this grant. Returns the power before.
    ///
    /// # Errors
    /// [`LeaseError`] if no power may be requested.
    pub fn request_power(
        &mut self,
        id: LeaseId,
        power_w: u16,
        now: Instant,
    ) -> Result<u16, LeaseError> {
        let held = self.heating(id, now)?;
        Ok(std::mem::replace(&mut held.power_w, power_w))
    }

    /// Applies an `off` of any user: earlier grants may no longer heat, and present power has to be switched off.
    pub fn off(&mut self) {
        self.offs += 1;
        if let Some(held) = &mut self.held {
            self.ending_w = self.ending_w.max(std::mem::take(&mut held.power_w));
        }
    }

    /// Requires that the device is switched off, whoever requested its power, until it confirms.
    pub fn require_off(&mut self) {
        self.is_off_due = true;
    }

    /// Returns `true` while a required `off` is not confirmed.
    pub fn is_off_due(&self) -> bool {
        self.is_off_due
    }

    /// Returns the requested power in watt, of the lease or of an ended one that is not yet switched off.
    pub fn asked_w(&self) -> u16 {
        let held_w = self.held.as_ref().map_or(0, |held| held.power_w);
        held_w.max(self.ending_w)
    }

    /// Returns `true` if power was requested that no valid lease covers, or an `off` is due: the device has to be switched off.
    pub fn must_switch_off(&self, now: Instant) -> bool {
        self.is_off_due || self.ending_w > 0 || (self.asked_w() > 0 && self.current(now).is_none())
    }

    /// Returns `true` if a valid lease has power, for which the device needs keep-alive messages.
    pub fn heats(&self, now: Instant) -> bool {
        !self.must_switch_off(now) && self.asked_w() > 0
    }

    /// Compares the lease's power with the request that the device reports, in watt; a panel may lower it. On any other difference the
    /// lease ends and is returned.
    pub fn check_device_power(&mut self, asked_w: u16, has_panel: bool) -> Option<LostLease> {
        let power_w = self.held.as_ref()?.power_w;
        let is_lowered = has_panel && (1..power_w).contains(&asked_w);
        if power_w == 0 || asked_w == power_w || is_lowered {
            return None;
        }
        let holder = self.end()?;
        if asked_w == 0 {
            self.ending_w = 0;
        }
        Some(LostLease { holder, power_w })
    }

    /// Records the device's confirmation that it is off.
    pub fn confirm_off(&mut self) {
        self.ending_w = 0;
        self.is_off_due = false;
        if let Some(held) = &mut self.held {
            held.power_w = 0;
        }
    }
}

#[cfg(test)]
mod tests;
