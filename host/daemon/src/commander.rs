//! Commands and leases: each command goes to the device's task under its holder's lease, `off` past it.

use std::sync::Arc;
use std::time::Duration;

use ihd_model::{Command, CommandError, CommandReply, EventKind, Lease, Trigger};
use tokio::sync::oneshot;
use tokio::time::Instant;

use crate::auditor::Auditor;
use crate::device::{DeviceRequest, not_connected_error};
use crate::device_record::DeviceRecord;
use crate::lease::{LeaseGrant, LeaseId};
use crate::printable::printable;
use crate::store_thread::StoreThread;
use crate::supervisor::{Devices, Handle};
use crate::switching_off::switch_off;

/// Time limit of a command.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(15);

/// Longest name of a holder, in characters.
const MAX_HOLDER: usize = 128;

/// Commander of all devices.
pub struct Commander {
    devices: Arc<Devices>,
    auditor: Arc<Auditor>,
    store: StoreThread,
}

impl Commander {
    /// Creates the commander of these devices.
    pub fn new(devices: Arc<Devices>, auditor: Arc<Auditor>, store: StoreThread) -> Self {
        Self {
            devices,
            auditor,
            store,
        }
    }

    fn handle(&self, name: &str) -> Result<Handle, CommandError> {
        let handle = self.devices.get(name);
        handle.ok_or_else(|| CommandError::NoDevice {
            name: printable(name),
        })
    }

    /// Carries out a command. All but [`Command::Off`] and recordings need the lease. A free lease is taken for the duration of the
    /// command, and for [`crate::lease::LEASE_S`] if it heats. [`Command::Off`] waits for no other command and cancels earlier power
    /// requests. The audit is written after the response.
    ///
    /// # Errors
    /// [`CommandError`] if the command was not carried out.
    pub async fn command(
        &self,
        device: &str,
        holder: &str,
        command: Command,
    ) -> Result<CommandReply, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let text = describe(&command);
        let outcome = self.carry_out(&handle, &holder, command).await;
        let response = match &outcome {
            Ok(reply) => reply.text.clone(),
            Err(error) => error.to_string(),
        };
        let ok = outcome.is_ok();
        tracing::info!(
            device = handle.record.name,
            holder,
            command = text,
            ok,
            response,
            "command"
        );
        handle.record.publish(EventKind::Command {
            holder: holder.clone(),
            text: text.clone(),
            ok,
        });
        let auditor = &self.auditor;
        auditor.record(&handle.record, holder, text, response);
        outcome
    }

    async fn carry_out(
        &self,
        handle: &Handle,
        holder: &str,
        command: Command,
    ) -> Result<CommandReply, CommandError> {
        let record = &handle.record;
        let lease = match command {
            Command::Off => return self.off(handle).await,
            // A recording only observes and needs no lease.
            Command::RecordStart(_) | Command::RecordStop => None,
            _ => Some(self.borrow_lease(record, holder)?),
        };
        let outcome = match command {
            Command::Power { power_w: 0 } => self.off(handle).await,
            _ => self.request(handle, command, lease).await,
        };
        if lease.is_some_and(|id| record.lock().lease.end_command(id)) {
            self.publish_lease(record, "", "");
        }
        outcome
    }

    /// Sends a command to the device's task and waits for its outcome.
    async fn request(
        &self,
        handle: &Handle,
        command: Command,
        lease: Option<LeaseId>,
    ) -> Result<CommandReply, CommandError> {
        let (reply, replied) = oneshot::channel();
        let request = DeviceRequest::Command {
            command,
            lease,
            reply,
        };
        let outcome = tokio::time::timeout(COMMAND_TIMEOUT, async {
            handle.requests.send(request).await.ok()?;
            replied.await.ok()
        });
        match outcome.await {
            Ok(Some(outcome)) => outcome,
            // The device's task panicked or is ending.
            Ok(None) => Err(CommandError::Failed {
                why: format!(
                    "{}: the command was not carried out: its task ended",
                    handle.record.name
                ),
            }),
            Err(_) => Err(timed_out(&handle.record)),
        }
    }

    /// Switches off at once, ahead of all other requests, and cancels earlier power requests.
    async fn off(&self, handle: &Handle) -> Result<CommandReply, CommandError> {
        let record = &handle.record;
        let client = {
            let mut inner = record.lock();
            inner.lease.off();
            inner.sweep_left_w.clear();
            if inner.client.is_some() {
                inner.lease.require_off();
            }
            inner.client.clone()
        };
        let client = client.ok_or_else(|| not_connected_error(record))?;
        let off = tokio::time::timeout(COMMAND_TIMEOUT, switch_off(record, &client));
        let off = off.await.map_err(|_| timed_out(record))?;
        // After an error the device's task tries again until the device confirms.
        off.map_err(|error| CommandError::Refused {
            name: record.name.clone(),
            why: printable(&error.to_string()),
        })?;
        Ok(CommandReply::with_text("off"))
    }

    /// Takes the lease or renews it. With `force` it is also taken from another holder; that is published, and the
    /// heating of the other ends.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it; [`CommandError::Failed`] if the device does not confirm that it is off.
    pub async fn take_lease(
        &self,
        device: &str,
        holder: &str,
        force: bool,
    ) -> Result<Lease, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let record = &handle.record;
        let grant = record.lock().lease.take(&holder, force, Instant::now());
        let grant = grant.map_err(|lease| leased_error(record, lease))?;
        self.publish_grant(record, &holder, &grant);
        if let LeaseGrant::From(other) = grant {
            let why = format!("{holder} has taken the lease from {other}");
            tracing::warn!(device = record.name, "{why}");
            let command = "take-lease --force".to_owned();
            let auditor = &self.auditor;
            auditor.record(record, holder.clone(), command, why.clone());
            self.end_heating(&handle, why).await?;
        }
        let now = Instant::now();
        let lease = record.lock().lease.current(now);
        lease.ok_or_else(|| CommandError::Failed {
            why: format!("{}: the lease ran out meanwhile", record.name),
        })
    }

    /// Takes or renews the lease for one command.
    fn borrow_lease(&self, record: &DeviceRecord, holder: &str) -> Result<LeaseId, CommandError> {
        let begun = record.lock().lease.begin_command(holder, Instant::now());
        let (id, grant) = begun.map_err(|lease| leased_error(record, lease))?;
        self.publish_grant(record, holder, &grant);
        Ok(id)
    }

    fn publish_grant(&self, record: &DeviceRecord, holder: &str, grant: &LeaseGrant) {
        match grant {
            LeaseGrant::Renewed => {}
            LeaseGrant::New => self.publish_lease(record, holder, ""),
            LeaseGrant::From(other) => self.publish_lease(record, holder, other),
        }
    }

    fn publish_lease(&self, record: &DeviceRecord, holder: &str, taken_from: &str) {
        record.publish(EventKind::Lease {
            holder: holder.to_owned(),
            taken_from: taken_from.to_owned(),
            why: String::new(),
        });
    }

    /// Releases the lease and switches off its power.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it; [`CommandError::Failed`] if the device does not confirm that it is off.
    pub async fn release_lease(&self, device: &str, holder: &str) -> Result<(), CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let record = &handle.record;
        let now = Instant::now();
        let (released, other) = {
            let mut inner = record.lock();
            (inner.lease.release(&holder), inner.lease.current(now))
        };
        if let Some(other) = other {
            return Err(leased_error(record, other));
        }
        if released {
            self.publish_lease(record, "", "");
            self.end_heating(&handle, format!("{holder} has given the lease back"))
                .await?;
        }
        Ok(())
    }

    /// Switches off the power of a lease that has ended.
    ///
    /// # Errors
    /// [`CommandError::Failed`] if the device does not confirm it; the device's task tries again.
    async fn end_heating(&self, handle: &Handle, why: String) -> Result<(), CommandError> {
        let record = &handle.record;
        let client = {
            let inner = record.lock();
            let must_switch_off = inner.lease.must_switch_off(Instant::now());
            inner.client.clone().filter(|_| must_switch_off)
        };
        let Some(client) = client else {
            return Ok(());
        };
        tracing::info!(device = record.name, why, "off");
        record.store_event(self.store.access(), "off", &why);
        let off = tokio::time::timeout(COMMAND_TIMEOUT, switch_off(record, &client));
        let error = match off.await {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("nothing came within {} s", COMMAND_TIMEOUT.as_secs()),
        };
        let name = &record.name;
        tracing::warn!(device = name, error, "was not switched off in time");
        Err(CommandError::Failed {
            why: printable(&format!(
                "{name}: {why}, and it is not confirmed that the hob is off: {error}"
            )),
        })
    }
}

fn timed_out(record: &DeviceRecord) -> CommandError {
    CommandError::Failed {
        why: format!(
            "{}: the command was not carried out within {} s",
            record.name,
            COMMAND_TIMEOUT.as_secs()
        ),
    }
}

fn leased_error(record: &DeviceRecord, lease: Lease) -> CommandError {
    CommandError::Leased {
        name: record.name.clone(),
        holder: lease.holder,
        expires_in_s: lease.expires_in_s,
    }
}

/// Returns a holder's name from the API as printable, limited text for logs and terminals.
fn holder_name(holder: &str) -> String {
    let name: String = printable(holder).chars().take(MAX_HOLDER).collect();
    match name.trim() {
        "" => "somebody".to_owned(),
        name => name.to_owned(),
    }
}

/// Describes a command for logs and the audit.
fn describe(command: &Command) -> String {
    match command {
        Command::Power { power_w } => format!("power {power_w} W"),
        Command::Off => "off".to_owned(),
        Command::ClearFault => "clear-fault".to_owned(),
        Command::LookupPush { blob } => format!("lookup push ({} bytes)", blob.len()),
        Command::LookupRollback { version: None } => "lookup rollback".to_owned(),
        Command::LookupRollback {
            version: Some(version),
        } => format!("lookup rollback to version {version}"),
        Command::LookupReset => "lookup reset".to_owned(),
        Command::Sweep { powers_w } => {
            let powers: Vec<_> = powers_w.iter().take(64).map(u16::to_string).collect();
            format!("sweep {} W", powers.join(", "))
        }
        Command::RecordStart(settings) => match settings.trigger {
            Trigger::Now => "record start".to_owned(),
            trigger => format!("record start at {trigger}"),
        },
        Command::RecordStop => "record stop".to_owned(),
    }
}
