//! Push of lookups to the device: pending in the store, pushed, active once the device reports the version.

use ihd_link::{Client, LinkError};
use ihd_model::{CommandError, CommandReply, EventKind};
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_store::{Confidence, LookupRow};
use tokio::time::Instant;

use super::lookup_push::{Step, UnderWay};
use super::lookups::{Reconcile, next_version, reconcile};
use super::request::ReplySender;
use super::session::Session;
use crate::learning::Lookup;
use crate::printable::printable;

impl Session<'_> {
    /// Reconciles the lookup on the device, of version `on_device`, with the store.
    ///
    /// # Errors
    /// Error of the link.
    pub(super) async fn reconcile(&mut self, on_device: u32) -> Result<(), LinkError> {
        self.record.lock().lookup.on_device = Some(on_device);
        let lookup = match self.request(Client::read_lookup).await {
            Ok(lookup) => lookup,
            Err(error @ LinkError::DamagedLookup { .. }) => {
                tracing::warn!(device = self.record.name, %error, "lookup");
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let Some(rows) = self.stored_lookups().await else {
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
                    let lookup = Lookup::without_confidence(*lookup);
                    let _ = self.send_lookup(lookup, why, None).await;
                }
            }
        }
        self.update_lookup_report().await;
        Ok(())
    }

    /// Returns the device's lookups in the store, oldest first; `None` if the store does not respond.
    pub(super) async fn stored_lookups(&self) -> Option<Vec<LookupRow>> {
        let device = self.device_id?;
        let rows = self.context.in_store(move |store| store.lookups(device));
        rows.await
    }

    /// Makes the device's lookup the active one in the store.
    async fn adopt(&mut self, lookup: &RlLookup) {
        let Some(device) = self.device_id else { return };
        let (version, observed_cells) = (lookup.version, lookup.observed_cells());
        let lookup = lookup.clone();
        let adopted = self
            .context
            .in_store(move |store| store.adopt_lookup(device, &lookup))
            .await;
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
        self.update_lookup_report().await;
    }

    /// Pushes a lookup, under the next version if the device would refuse its own. It is pending in the store before it is
    /// sent. `reply` receives the outcome once the lookup is active or refused.
    ///
    /// # Errors
    /// Reason of the refusal, also sent to `reply`. The session continues.
    pub(super) async fn send_lookup(
        &mut self,
        pushed: Lookup,
        why: &str,
        reply: Option<ReplySender>,
    ) -> Result<(), String> {
        self.send(pushed, why, false, reply).await
    }

    /// Sends a lookup that the learner built.
    async fn send_learned(&mut self, lookup: Lookup) -> Result<(), String> {
        self.send(lookup, "learned", true, None).await
    }

    async fn send(
        &mut self,
        pushed: Lookup,
        why: &str,
        is_learned: bool,
        reply: Option<ReplySender>,
    ) -> Result<(), String> {
        let Lookup {
            mut lookup,
            confidence,
        } = pushed;
        let learned_version = is_learned.then_some(lookup.version);
        let outcome = self.try_push(&mut lookup, confidence, why).await;
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
                self.update_lookup_report().await;
                Err(why)
            }
        }
    }

    async fn try_push(
        &mut self,
        lookup: &mut RlLookup,
        confidence: Option<Confidence>,
        why: &str,
    ) -> Result<(), String> {
        let device = self.device_id.ok_or(
            "the store does not know the device: nothing is pushed that it could not keep",
        )?;
        let rows = self
            .stored_lookups()
            .await
            .ok_or("the store does not answer: nothing is pushed that it could not keep")?;
        let on_device = self.record.lock().lookup.on_device.unwrap_or(0);
        let highest = on_device.saturating_add(LOOKUP_VERSION_STEP);
        if lookup.version <= on_device || lookup.version > highest {
            lookup.version = next_version(on_device, &rows)?;
        }
        let (pending, reason) = (lookup.clone(), printable(why));
        let stored = self.context.in_store(move |store| {
            store.pend_lookup(device, &pending, &reason, confidence.as_ref())
        });
        let not_stored = "the store cannot keep it: nothing is pushed that it does not know";
        stored.await.ok_or(not_stored)?;
        let version = lookup.version;
        self.record.lock().lookup.pending = Some(version);
        let pushed = lookup.clone();
        match self
            .request(move |client| client.push_lookup(&pushed))
            .await
        {
            Ok(()) => Ok(()),
            Err(error @ LinkError::Refused { .. }) => {
                let reason = error.to_string();
                let refused = self
                    .context
                    .in_store(move |store| store.refuse_lookup(device, version, &reason));
                // If the store fails, the lookup stays pending until the next connection reconciles it.
                let _ = refused.await;
                Err(error.to_string())
            }
            // The next connection reads the lookup that the device uses.
            Err(error) => Err(error.to_string()),
        }
    }

    /// Carries out a step of the push.
    pub(super) async fn apply_push_step(&mut self, step: Step) {
        let (record, learner) = (self.record, &self.context.learner);
        let name = &record.name;
        match step {
            Step::Nothing => {}
            Step::Send(lookup) => {
                let version = lookup.lookup.version;
                if self.send_learned(*lookup).await.is_err() {
                    learner.lookup_refused(name, version);
                }
            }
            Step::Active(push) => {
                let version = push.lookup.version;
                // The pending lookup is equal bit for bit, and becomes active.
                self.adopt(&push.lookup).await;
                match push.is_learned {
                    true => learner.lookup_accepted(name, version),
                    false => learner.set_device_version(name, version),
                }
                if let Some(reply) = push.reply {
                    let _ = reply.send(Ok(CommandReply {
                        text: format!("version {version} is active"),
                        file: None,
                    }));
                }
            }
            Step::TimedOut(push) => {
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
    pub(super) async fn tick_push(&mut self) {
        loop {
            match self.push.tick(Instant::now()) {
                Step::Nothing => return,
                step => self.apply_push_step(step).await,
            }
        }
    }

    /// Ends a push whose outcome is unknown: the session ends, or the device is reset.
    pub(super) fn abandon_push(&mut self) {
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

    /// Resets the device to the built-in lookup and forgets what was learned.
    ///
    /// # Errors
    /// Error of the link.
    pub(super) async fn reset_lookup(&mut self) -> Result<(), LinkError> {
        self.request(Client::reset_lookup).await?;
        self.abandon_push();
        self.push.forget_queued();
        self.context.learner.forget(&self.record.name);
        self.context
            .learner
            .set_device_version(&self.record.name, 0);
        if let Some(device) = self.device_id {
            let forgotten = self.context.in_store(move |store| {
                store.forget_learner_state(device)?;
                store.adopt_lookup(device, &prior())
            });
            self.must_reconcile = forgotten.await.is_none();
        }
        self.update_lookup_report().await;
        Ok(())
    }

    /// Updates the lookup versions of the report from the store.
    pub(super) async fn update_lookup_report(&mut self) {
        let Some(rows) = self.stored_lookups().await else {
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
