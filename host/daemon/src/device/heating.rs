//! Power of a session: requests under a lease, keep-alive, sweep, and the ways to off.

use std::sync::Arc;

use ihd_link::{Client, GrantedPower, LinkError};
use ihd_model::DeviceState;
use ihd_shared::wire::messages::{NO_PANEL, Status};
use ihd_train::WINDOWS_EVERY;
use tokio::runtime::Handle;
use tokio::time::Instant;

use super::contact::DueCheck;
use super::session::{DeviceSession, SessionEnd};
use super::sweep::{SweepState, SweepStep};
use crate::lease::{LeaseError, LeaseId, LostLease};
use crate::switching_off::switch_off;

/// Error of a power request.
#[derive(Debug, thiserror::Error)]
pub(super) enum HeatError {
    /// The lease is not valid.
    #[error(transparent)]
    Lease(#[from] LeaseError),
    /// The device refused, or did not answer.
    #[error(transparent)]
    Link(#[from] LinkError),
}

impl HeatError {
    /// Returns `true` if the device may have taken the power.
    pub(super) fn is_unknown(&self) -> bool {
        match self {
            Self::Lease(_) | Self::Link(LinkError::Refused { .. }) => false,
            Self::Link(_) => true,
        }
    }
}

impl DeviceSession<'_> {
    /// Sends the keep-alive while heating for a lease, and queries a silent device.
    pub(super) async fn keep_alive(&mut self) -> Result<(), SessionEnd> {
        let heats_for_us = self.record.lock().lease.heats(Instant::now());
        let Some(check) = self.link.contact.due_check(heats_for_us) else {
            return Ok(());
        };
        if check == DueCheck::Silence {
            // Without the time, which goes on while the state stays.
            self.record
                .enter(DeviceState::Suspended, "nothing came, and it is asked");
        }
        match self.check_power().await {
            Ok(()) => {
                self.link.contact.answered(check);
                if check == DueCheck::Silence {
                    // It answers without streaming, as after a hello of another host.
                    let restarted = self
                        .link
                        .request(|client| client.stream(1, WINDOWS_EVERY))
                        .await;
                    restarted.map_err(|error| SessionEnd::Link(error.to_string()))?;
                }
            }
            Err(LinkError::Preempted { .. }) => self.link.contact.preempted(),
            Err(error @ LinkError::NoAnswer { .. }) if self.link.contact.unanswered() => {
                tracing::debug!(device = self.record.name, %error, "no answer");
            }
            Err(error) => return Err(SessionEnd::Link(error.to_string())),
        }
        if self.link.contact.is_lost() {
            return Err(SessionEnd::Link(
                "it answers and sends no half-cycles".to_owned(),
            ));
        }
        Ok(())
    }

    /// Compares the device's requested power with the lease's. Another host's hello or the panel may have ended it.
    pub(super) async fn check_power(&mut self) -> Result<(), LinkError> {
        self.link.contact.on_check();
        let (record, runtime) = (Arc::clone(self.record), Handle::current());
        let compare = move |client: &mut Client| -> Result<_, LinkError> {
            let status = client.status()?;
            // On the link's thread, as all power requests, so that status and lease are of the same moment.
            let _in_runtime = runtime.enter();
            let has_panel = status.panel_level != NO_PANEL;
            let lost = record
                .lock()
                .lease
                .check_device_power(status.asked_w, has_panel);
            Ok(lost.map(|lost| (lost, status.asked_w)))
        };
        if let Some((lost, asked_w)) = self.link.request(compare).await? {
            self.publish_lost_lease(&lost, asked_w);
        }
        Ok(())
    }

    /// Publishes that a lease ended because the device has `asked_w` in place of its power.
    pub(super) fn publish_lost_lease(&self, lost: &LostLease, asked_w: u16) {
        let LostLease { holder, power_w } = lost;
        let has = match asked_w {
            0 => "is asked for no power any more".to_owned(),
            asked_w => format!("is asked for {asked_w} W"),
        };
        let why = format!(
            "the hob {has}, and not for the {power_w} W of {holder}: another host spoke to it, or it was switched off there"
        );
        tracing::warn!(
            device = self.record.name,
            holder,
            why,
            "the lease has ended"
        );
        self.store_event("lease", &why);
        self.record.publish_lease_end(why);
    }

    /// Returns the sweep; drops it if its lease or its power has ended.
    pub(super) fn active_sweep(&mut self) -> Option<&mut SweepState> {
        let (lease, _) = self.sweep.as_ref()?;
        let mut inner = self.record.lock();
        if inner.lease.check_heating(*lease, Instant::now()).is_err() {
            inner.sweep_left_w.clear();
            self.sweep = None;
        }
        drop(inner);
        self.sweep.as_mut().map(|(_, sweep)| sweep)
    }

    /// Carries out a sweep's action.
    pub(super) async fn apply_sweep_step(&mut self, step: SweepStep) -> Result<(), SessionEnd> {
        match step {
            SweepStep::Nothing => {}
            SweepStep::Log(text) => {
                tracing::info!(device = self.record.name, "{text}");
                self.store_event("sweep", &text);
            }
            SweepStep::SetPower(power_w) => {
                tracing::info!(device = self.record.name, power_w, "sweep");
                let Some((lease, _)) = self.sweep else {
                    return Ok(());
                };
                match self.heat(lease, power_w).await {
                    Ok(granted) => self.note_granted(granted),
                    Err(error) => {
                        self.end_heating(&format!("the sweep ended: {error}"))
                            .await?;
                    }
                }
            }
            SweepStep::Complete => {
                self.record.lock().sweep_is_complete = true;
                self.end_heating("the sweep ended: done").await?;
            }
            SweepStep::End(why) => self.end_heating(&format!("the sweep ended: {why}")).await?,
        }
        let sweep = self.sweep.as_ref();
        let left = sweep.map(|(_, sweep)| sweep.left_w()).unwrap_or_default();
        self.record.lock().sweep_left_w = left;
        Ok(())
    }

    /// Lets the sweep go on with what the device took of its power.
    fn note_granted(&mut self, granted: GrantedPower) {
        if granted.is_reduced() {
            self.store_event("sweep", &format!("sweep: {granted}"));
        }
        if let Some((_, sweep)) = &mut self.sweep {
            sweep.take_granted(granted.granted_w);
        }
    }

    /// Requests power under a lease, which has what the device took of it.
    ///
    /// # Errors
    /// [`HeatError`] if the lease has ended, or the link failed.
    pub(super) async fn heat(
        &mut self,
        lease: LeaseId,
        power_w: u16,
    ) -> Result<GrantedPower, HeatError> {
        if self.record.lock().lease.must_switch_off(Instant::now()) {
            // Power of an ended lease: the new lease begins with the hob off.
            self.off().await?;
        }
        self.link.contact.on_request();
        let (record, runtime) = (Arc::clone(self.record), Handle::current());
        let set_power = move |client: &mut Client| -> Result<GrantedPower, HeatError> {
            // For the clock. On the link's thread, so that an `off` comes either before lease and device, or after both.
            let _in_runtime = runtime.enter();
            let set_lease_power = |power_w| {
                record
                    .lock()
                    .lease
                    .request_power(lease, power_w, Instant::now())
            };
            let before = set_lease_power(power_w)?;
            let outcome = client.set_power(power_w);
            // These fail if the lease has ended, and then the power is switched off.
            match &outcome {
                // The device keeps its previous power.
                Err(LinkError::Refused { .. }) => drop(set_lease_power(before)),
                Ok(granted) if granted.is_reduced() => drop(set_lease_power(granted.granted_w)),
                _ => {}
            }
            Ok(outcome?)
        };
        self.link.client.with(set_power).await?
    }

    /// Switches off and ends the sweep.
    ///
    /// # Errors
    /// Error of the link.
    pub(super) async fn off(&mut self) -> Result<(), LinkError> {
        self.sweep = None;
        self.record.lock().sweep_left_w.clear();
        self.link.contact.on_request();
        switch_off(self.record, &self.link.client).await
    }

    /// Switches off power requested through the daemon, or for an `off` that is due, for this reason; else does nothing.
    ///
    /// # Errors
    /// The end of the session, if the link failed.
    pub(super) async fn end_heating(&mut self, why: &str) -> Result<(), SessionEnd> {
        let has_power = {
            let lease = &self.record.lock().lease;
            lease.asked_w() > 0 || lease.is_off_due()
        };
        if !has_power && self.sweep.is_none() {
            return Ok(());
        }
        tracing::info!(device = self.record.name, why, "off");
        self.store_event("off", why);
        self.off()
            .await
            .map_err(|error| SessionEnd::Link(error.to_string()))
    }

    /// Ends power from before this connection. A device ends it itself at the hello; one that still heats, and not for its
    /// panel, is switched off; for its panel too if an `off` is due.
    pub(super) async fn end_previous_power(&mut self, status: &Status) -> Result<(), LinkError> {
        let is_off_due = self.record.lock().lease.is_off_due();
        if status.asked_w == 0 || (status.panel_level != NO_PANEL && !is_off_due) {
            self.record.lock().lease.confirm_off();
            return Ok(());
        }
        let asked_w = status.asked_w;
        tracing::warn!(
            device = self.record.name,
            asked_w,
            "its hello did not end its heating: switched off"
        );
        self.off().await
    }
}
