//! Lookups of one device during a session: pending in the store, pushed, active once the device reports the version.

use std::sync::Arc;

use ihd_link::{Client, LinkError};
use ihd_model::{CommandError, CommandReply, EventKind};
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_store::{Certainty, DeviceId};
use tokio::time::Instant;

use super::device_link::DeviceLink;
use super::lookup_push::{LookupPush, PushStep, UnderWay};
use super::lookup_rows::LookupRows;
use super::reconcile::{Reconcile, next_version, reconcile};
use super::request::ReplySender;
use super::store_wait::StoreWait;
use crate::context::Context;
use crate::device_record::DeviceRecord;
use crate::learning::LookupToPush;
use crate::printable::printable;

/// Lookups of a connected device, kept equal in store, device and learner.
pub struct DeviceLookups<'a> {
    record: &'a Arc<DeviceRecord>,
    context: &'a Context,
    rows: LookupRows<'a>,
    push: LookupPush,
    /// `true` while the lookups of store and device may differ.
    must_reconcile: bool,
}

impl<'a> DeviceLookups<'a> {
    /// Creates the lookups of a device that the store does not know yet.
    pub fn new(record: &'a Arc<DeviceRecord>, context: &'a Context, wait: Arc<StoreWait>) -> Self {
        Self {
            record,
            context,
            rows: LookupRows {
                name: &record.name,
                wait,
                device_id: None,
            },
            push: LookupPush::default(),
            must_reconcile: false,
        }
    }

    /// Sets the row of the device in the store.
    pub fn set_device(&mut self, device: DeviceId) {
        self.rows.device_id = Some(device);
    }

    /// Requires a reconciliation with the next [`DeviceLookups::retry_reconciliation`].
    pub fn require_reconciliation(&mut self) {
        self.must_reconcile = true;
    }

    /// Reconciles if that is required and no push is under way.
    ///
    /// # Errors
    /// Error of the link.
    pub async fn retry_reconciliation(&mut self, link: &mut DeviceLink) -> Result<(), LinkError> {
        if self.push.is_under_way() || !std::mem::take(&mut self.must_reconcile) {
            return Ok(());
        }
        let on_device = self.record.lock().lookup.on_device.unwrap_or(0);
        self.reconcile(link, on_device).await
    }

    /// Processes a lookup that the learner built.
    pub async fn learned(&mut self, link: &mut DeviceLink, lookup: Box<LookupToPush>) {
        let step = self.push.learned(lookup);
        self.apply(link, step).await;
    }

    /// Processes the version that the device reports.
    pub async fn reported(&mut self, link: &mut DeviceLink, version: u32) {
        let step = self.push.reported(version);
        self.apply(link, step).await;
    }

    /// Reconciles the lookup on the device, of version `on_device`, with the store.
    ///
    /// # Errors
    /// Error of the link.
    pub async fn reconcile(
        &mut self,
        link: &mut DeviceLink,
        on_device: u32,
    ) -> Result<(), LinkError> {
        self.record.lock().lookup.on_device = Some(on_device);
        let lookup = match link.request(Client::read_lookup).await {
            Ok(lookup) => lookup,
            Err(error @ LinkError::DamagedLookup { .. }) => {
                tracing::warn!(device = self.record.name, %error, "lookup");
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let Some(rows) = self.rows.read().await else {
            self.must_reconcile = true;
            return Ok(());
        };
        self.context
            .learner
            .set_device_version(&self.record.name, on_device);
        for step in reconcile(&lookup, &rows) {
            match step {
                Reconcile::Nothing => {}
                Reconcile::Activate(_) | Reconcile::Adopt => self.adopt(&lookup).await,
                Reconcile::Push(lookup, why) => {
                    let lookup = LookupToPush::without_certainty(*lookup);
                    let _ = self.push(link, lookup, why, None).await;
                }
            }
        }
        self.update_report().await;
        Ok(())
    }

    /// Returns the stored lookup of this version; for `None` the one that was active before the present one.
    ///
    /// # Errors
    /// Reason why there is none.
    pub async fn find(&self, version: Option<u32>) -> Result<LookupToPush, String> {
        let on_device = self.record.lock().lookup.on_device.unwrap_or(0);
        self.rows.find(version, on_device).await
    }

    /// Makes the device's lookup the active one in the store.
    async fn adopt(&mut self, lookup: &RlLookup) {
        if self.rows.device_id.is_none() {
            return;
        }
        let (version, observed_cells) = (lookup.version, lookup.observed_cells());
        let adopted = self.rows.adopt(lookup.clone()).await;
        if adopted.is_none() {
            // The store still has it as pending.
            self.must_reconcile = true;
        } else if version > 0 {
            tracing::info!(
                device = self.record.name,
                version,
                observed_cells,
                "lookup active"
            );
            self.record.publish(EventKind::LookupActive {
                version,
                observed_cells,
            });
        }
        self.update_report().await;
    }

    /// Pushes a lookup, under the next version if the device would refuse its own. It is pending in the store before it is
    /// sent. `reply` receives the outcome once the lookup is active or refused.
    ///
    /// # Errors
    /// Reason of the refusal, also sent to `reply`. The session continues.
    pub async fn push(
        &mut self,
        link: &mut DeviceLink,
        pushed: LookupToPush,
        why: &str,
        reply: Option<ReplySender>,
    ) -> Result<(), String> {
        self.send(link, pushed, why, false, reply).await
    }

    async fn send(
        &mut self,
        link: &mut DeviceLink,
        pushed: LookupToPush,
        why: &str,
        is_learned: bool,
        reply: Option<ReplySender>,
    ) -> Result<(), String> {
        let LookupToPush {
            mut lookup,
            certainty,
        } = pushed;
        let learned_version = is_learned.then_some(lookup.version);
        let outcome = self.try_push(link, &mut lookup, certainty, why).await;
        let version = lookup.version;
        match outcome {
            Ok(()) => {
                let push = UnderWay {
                    lookup: Box::new(lookup),
                    // The version differs if the device received another lookup meanwhile.
                    is_learned: learned_version == Some(version),
                    reply,
                };
                let replaced = self.push.accepted(push, Instant::now());
                self.reply_abandoned(replaced);
                Ok(())
            }
            Err(why) => {
                let why = printable(&why);
                tracing::warn!(device = self.record.name, version, why, "lookup refused");
                self.record.publish(EventKind::LookupRefused {
                    version,
                    why: why.clone(),
                });
                self.reply_refused(reply, &why);
                self.update_report().await;
                Err(why)
            }
        }
    }

    async fn try_push(
        &self,
        link: &mut DeviceLink,
        lookup: &mut RlLookup,
        certainty: Option<Certainty>,
        why: &str,
    ) -> Result<(), String> {
        if self.rows.device_id.is_none() {
            let why =
                "the store does not know the device: nothing is pushed that it could not keep";
            return Err(why.to_owned());
        }
        let rows = self
            .rows
            .read()
            .await
            .ok_or("the store does not answer: nothing is pushed that it could not keep")?;
        let on_device = self.record.lock().lookup.on_device.unwrap_or(0);
        let highest = on_device.saturating_add(LOOKUP_VERSION_STEP);
        if lookup.version <= on_device || lookup.version > highest {
            lookup.version = next_version(on_device, &rows)?;
        }
        let pending = self.rows.pend(lookup, printable(why), certainty);
        let not_stored = "the store cannot keep it: nothing is pushed that it does not know";
        pending.await.ok_or(not_stored)?;
        let version = lookup.version;
        self.record.lock().lookup.pending = Some(version);
        let pushed = lookup.clone();
        match link
            .request(move |client| client.push_lookup(&pushed))
            .await
        {
            Ok(()) => Ok(()),
            Err(error @ LinkError::Refused { .. }) => {
                let why = error.to_string();
                self.rows.refuse(version, why.clone()).await;
                Err(why)
            }
            // The next connection reads the lookup that the device uses.
            Err(error) => Err(error.to_string()),
        }
    }

    /// Carries out a step of the push.
    async fn apply(&mut self, link: &mut DeviceLink, step: PushStep) {
        let (record, learner) = (self.record, &self.context.learner);
        let name = &record.name;
        match step {
            PushStep::Nothing => {}
            PushStep::Send(lookup) => {
                let version = lookup.lookup.version;
                let sent = self.send(link, *lookup, "learned", true, None).await;
                if sent.is_err() {
                    learner.lookup_refused(name, version);
                }
            }
            PushStep::Active(push) => {
                let version = push.lookup.version;
                // The pending lookup is equal bit for bit, and becomes active.
                self.adopt(&push.lookup).await;
                match push.is_learned {
                    true => learner.lookup_accepted(name, version),
                    false => learner.set_device_version(name, version),
                }
                if let Some(reply) = push.reply {
                    let _ = reply.send(Ok(CommandReply::with_text(format!(
                        "version {version} is active"
                    ))));
                }
            }
            PushStep::TimedOut(push) => {
                let version = push.lookup.version;
                if push.is_learned {
                    learner.lookup_refused(name, version);
                }
                let why = "the device took it and does not use it";
                tracing::warn!(device = name, version, why, "lookup");
                record.publish(EventKind::LookupRefused {
                    version,
                    why: why.to_owned(),
                });
                self.reply_refused(push.reply, why);
            }
        }
    }

    /// Ends a push that is not used in time, and sends the lookup that waits.
    pub async fn tick(&mut self, link: &mut DeviceLink) {
        loop {
            match self.push.tick(Instant::now()) {
                PushStep::Nothing => return,
                step => self.apply(link, step).await,
            }
        }
    }

    /// Ends a push whose outcome is unknown: the session ends, or the device is reset.
    pub fn abandon_push(&mut self) {
        let abandoned = self.push.abandon();
        self.reply_abandoned(abandoned);
    }

    fn reply_abandoned(&self, push: Option<UnderWay>) {
        if let Some(push) = push {
            self.reply_refused(
                push.reply,
                "it was pushed, and the link ended before the device used it",
            );
        }
    }

    /// Resets the device to the built-in lookup and forgets what was learned: in the store first, else the next reconciliation would
    /// push it again.
    ///
    /// # Errors
    /// Text of the store's failure, or of the link's.
    pub async fn reset(&mut self, link: &mut DeviceLink) -> Result<(), String> {
        let forgotten = self.rows.reset().await;
        forgotten.ok_or("the store cannot forget what was learned: nothing is reset")?;
        self.context.learner.forget(&self.record.name);
        let reset = link.request(Client::reset_lookup).await;
        reset.map_err(|error| error.to_string())?;
        self.abandon_push();
        self.push.forget_queued();
        self.context
            .learner
            .set_device_version(&self.record.name, 0);
        self.update_report().await;
        Ok(())
    }

    /// Updates the lookup versions of the report from the store, unless it was too slow in this step.
    async fn update_report(&mut self) {
        if self.rows.wait.is_over() {
            return;
        }
        let Some(rows) = self.rows.read().await else {
            return;
        };
        let newest = |state| rows.iter().rev().find(|row| row.state == state);
        let active = newest(ihd_store::LookupState::Active);
        let lookup = active.and_then(|row| RlLookup::from_bytes(&row.blob).ok());
        let mut inner = self.record.lock();
        inner.lookup.active = active.map(|row| row.version);
        inner.lookup.pending = newest(ihd_store::LookupState::Pending).map(|row| row.version);
        inner.lookup.observed_cells = lookup.map_or(0, |l| l.observed_cells());
    }

    fn reply_refused(&self, reply: Option<ReplySender>, why: &str) {
        if let Some(reply) = reply {
            let _ = reply.send(Err(CommandError::Refused {
                name: self.record.name.clone(),
                why: why.to_owned(),
            }));
        }
    }
}
