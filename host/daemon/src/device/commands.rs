//! Execution of commands on a connected device.

use ihd_link::{Client, GrantedPower, LinkError};
use ihd_model::{Command, CommandError, CommandReply};
use ihd_shared::hob::REQUESTED_POWER_MAX_W;
use ihd_shared::lookup::RlLookup;
use tokio::time::Instant;

use super::heating::HeatError;
use super::recording;
use super::request::{DeviceRequest, ReplySender};
use super::session::{DeviceSession, SessionEnd};
use super::sweep::SweepState;
use crate::learning::LookupToPush;
use crate::lease::{LeaseError, LeaseId};
use crate::printable::printable;

/// Largest number of powers in a sweep.
const MAX_SWEEP_POWERS: usize = 64;

impl DeviceSession<'_> {
    /// Carries out a request.
    ///
    /// # Errors
    /// The end of the session.
    pub(super) async fn on_request(&mut self, request: DeviceRequest) -> Result<(), SessionEnd> {
        match request {
            DeviceRequest::PushLookup {
                lookup,
                forgotten_count,
            } => {
                let learner = &self.context.learner;
                // One from before a reset has waited behind it.
                if !learner.has_forgotten(&self.record.name, forgotten_count) {
                    self.lookups.learned(&mut self.link, lookup).await;
                }
                Ok(())
            }
            DeviceRequest::Command {
                command,
                lease,
                reply,
            } => self.on_command(command, lease, reply).await,
        }
    }

    async fn on_command(
        &mut self,
        command: Command,
        lease: Option<LeaseId>,
        reply: ReplySender,
    ) -> Result<(), SessionEnd> {
        if reply.is_closed() {
            // Its requester was told that it is not carried out.
            return Ok(());
        }
        if let Err(why) = self.check_lease(&command, lease) {
            let _ = reply.send(Err(self.refused_error(&why)));
            return Ok(());
        }
        let mut session = Ok(());
        let may_heat = match &command {
            Command::Power { power_w } => *power_w > 0,
            command => matches!(command, Command::Sweep { .. }),
        };
        let outcome = match command {
            Command::Off | Command::Power { power_w: 0 } => {
                let off = self.off().await;
                let done = off.as_ref().map(|()| "off".to_owned()).map_err(describe);
                session = off.map_err(|error| SessionEnd::Link(error.to_string()));
                done.map(CommandReply::with_text)
            }
            Command::Power { power_w } => {
                let granted = self.power(lease, power_w).await;
                if granted.as_ref().is_err_and(HeatError::is_unknown) {
                    // Without a confirmed off the session ends, and its keep-alive with it.
                    session = self.end_heating("power was not answered").await;
                }
                let granted = granted.map_err(|error| error.to_string());
                granted.map(|granted| CommandReply {
                    granted_w: Some(granted.granted_w),
                    ..CommandReply::with_text(granted.to_string())
                })
            }
            Command::Sweep { powers_w } => {
                let started = self.start_sweep(lease, &powers_w);
                started.map(CommandReply::with_text)
            }
            Command::ClearFault => {
                let cleared = self.link.request(Client::clear_fault).await;
                let done = CommandReply::with_text("fault cleared");
                cleared.map(|()| done).map_err(|e| describe(&e))
            }
            Command::LookupReset => {
                let reset = self.lookups.reset(&mut self.link).await;
                let done = "back to the built-in lookup; what was learned is forgotten";
                let done = CommandReply::with_text(done);
                reset.map(|()| done)
            }
            // The others reply later: once the device uses the lookup, or the file is there.
            Command::LookupPush { blob } => {
                let lookup = RlLookup::from_bytes(&blob).map(LookupToPush::without_certainty);
                let found = lookup.map(|lookup| (lookup, "pushed by hand".to_owned()));
                self.push_lookup(found.map_err(|why| why.to_string()), reply)
                    .await;
                return Ok(());
            }
            Command::LookupRollback { version } => {
                let found = self.lookups.find(version).await.map(|lookup| {
                    let why = format!("rolled back to version {}", lookup.lookup.version);
                    (lookup, why)
                });
                self.push_lookup(found, reply).await;
                return Ok(());
            }
            Command::RecordStart(settings) => {
                self.start_recording(settings, reply).await;
                return Ok(());
            }
            Command::RecordStop => {
                recording::stop(self.record, reply);
                return Ok(());
            }
        };
        let heats = may_heat && outcome.is_ok();
        let replied = reply.send(outcome.map_err(|why| self.refused_error(&why)));
        if heats && replied.is_err() {
            return self.end_heating("its requester waited no longer").await;
        }
        session
    }

    /// Checks the lease of a command other than off, which may have ended while the command waited.
    fn check_lease(&self, command: &Command, lease: Option<LeaseId>) -> Result<(), String> {
        let is_off = matches!(command, Command::Power { power_w: 0 });
        let Some(id) = lease.filter(|_| !is_off) else {
            return Ok(());
        };
        let checked = self.record.lock().lease.check(id, Instant::now());
        checked.map_err(|error| error.to_string())
    }

    /// Pushes a lookup for a reason, or replies why there is none.
    async fn push_lookup(
        &mut self,
        found: Result<(LookupToPush, String), String>,
        reply: ReplySender,
    ) {
        match found {
            Ok((lookup, why)) => {
                let push = self.lookups.push(&mut self.link, lookup, &why, Some(reply));
                let _ = push.await;
            }
            Err(why) => {
                let _ = reply.send(Err(self.refused_error(&why)));
            }
        }
    }

    fn refused_error(&self, why: &str) -> CommandError {
        CommandError::Refused {
            name: self.record.name.clone(),
            why: printable(why),
        }
    }

    async fn power(
        &mut self,
        lease: Option<LeaseId>,
        power_w: u16,
    ) -> Result<GrantedPower, HeatError> {
        let lease = lease.ok_or(LeaseError::Ended)?;
        let granted = self.heat(lease, power_w).await?;
        // After a refusal the device has the sweep's power still.
        self.sweep = None;
        self.record.lock().sweep_left_w.clear();
        Ok(granted)
    }

    fn start_sweep(&mut self, lease: Option<LeaseId>, powers_w: &[u16]) -> Result<String, String> {
        let lease = lease.ok_or_else(|| LeaseError::Ended.to_string())?;
        if powers_w.is_empty() || powers_w.len() > MAX_SWEEP_POWERS {
            return Err(format!("a sweep has 1 to {MAX_SWEEP_POWERS} powers"));
        }
        if let Some(invalid) = powers_w
            .iter()
            .find(|&&w| w == 0 || w > REQUESTED_POWER_MAX_W)
        {
            return Err(format!("{invalid} W is not 1 to {REQUESTED_POWER_MAX_W} W"));
        }
        let sweep = SweepState::new(powers_w);
        {
            let mut inner = self.record.lock();
            let extended = inner.lease.keep_after_command(lease, Instant::now());
            extended.map_err(|error| error.to_string())?;
            inner.sweep_left_w = sweep.left_w();
            inner.sweep_is_complete = false;
        }
        self.sweep = Some((lease, sweep));
        Ok(format!(
            "sweep through {} powers begun; it ends with the lease",
            powers_w.len()
        ))
    }
}

fn describe(error: &LinkError) -> String {
    error.to_string()
}
