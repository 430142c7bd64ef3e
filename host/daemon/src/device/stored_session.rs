//! Session of a device in the store.

use std::sync::Arc;

use ihd_link::{Client, LinkError};
use ihd_store::{DeviceId, Store, StoreError};

use super::session::{DeviceSession, SessionEnd, StoredIds};
use crate::learning::Learner;
use crate::store_thread::StoreAccess;

impl DeviceSession<'_> {
    /// Begins the session in the store. If that fails, nothing is stored until [`DeviceSession::retry_store`] succeeds.
    ///
    /// # Errors
    /// Error of the link.
    pub(super) async fn begin_stored_session(&mut self) -> Result<(), LinkError> {
        let (name, address) = (self.record.name.clone(), self.record.address.clone());
        let hello = self.link.client.hello().clone();
        let front_end = self.link.client.front_end().clone();
        let chip = self.chip().await?;
        let learner = Arc::clone(&self.context.learner);
        let is_resumed = self.record.lock().is_resumed;
        let began = self.store_wait.run(move |store| {
            let device = store.device(&name, &address)?;
            if let Some(chip) = chip {
                recognise_board(store, &learner, (&name, device), &chip)?;
            }
            let session = store.begin_session(device, &hello, &front_end)?;
            let (learned, alloys) = match is_resumed {
                true => (None, None),
                false => (store.learner_state(device)?, store.alloys(device)?),
            };
            Ok((device, session, learned, alloys))
        });
        // Errors of the store are reported by its thread.
        if let Some((device, session, learned, alloys)) = began.await {
            self.stored = Some(StoredIds { device, session });
            self.lookups.set_device(device);
            self.record.lock().is_resumed = true;
            let added = self
                .context
                .learner
                .add(&self.record.name, learned.as_deref());
            let boot = self.link.client.hello().boot_id;
            self.context.learner.begin_boot(&self.record.name, boot);
            if let Err(error) = added {
                tracing::warn!(device = self.record.name, %error, "what was learned is lost");
                self.store_event("learned", &error.to_string());
            }
            let known = alloys.map(|json| self.record.pot_tracker().set_stored_alloys(&json));
            if let Some(Err(error)) = known {
                tracing::warn!(device = self.record.name, %error, "the pots' alloys are lost");
                self.store_event("learned", &format!("the pots' alloys: {error}"));
            }
        }
        Ok(())
    }

    /// Stores an event of the device, also while the store has no session of it.
    pub(super) fn store_event(&self, kind: &'static str, text: &str) {
        self.record.store_event(self.store(), kind, text);
    }

    /// Returns the number of the device's chip; `None` if it has none, or does not tell it.
    ///
    /// # Errors
    /// Error of the link: another board may have come under the name.
    async fn chip(&mut self) -> Result<Option<String>, LinkError> {
        match self.link.request(Client::board).await {
            Ok(facts) => Ok(Some(facts.chip_number()).filter(|number| !number.is_empty())),
            Err(LinkError::Refused { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns access to the store in this device's lane.
    pub(super) fn store(&self) -> StoreAccess {
        self.context.store.of_device(&self.record.name)
    }

    /// Retries what the store failed to do.
    pub(super) async fn retry_store(&mut self) -> Result<(), SessionEnd> {
        if self.stored.is_none() {
            match self.begin_stored_session().await {
                // By an `off`; the next retry.
                Err(LinkError::Preempted { .. }) => return Ok(()),
                began => began.map_err(|error| SessionEnd::Link(error.to_string()))?,
            }
            if self.stored.is_some() {
                self.lookups.require_reconciliation();
            }
        }
        if self.stored.is_some() {
            let reconciled = self.lookups.retry_reconciliation(&mut self.link).await;
            reconciled.map_err(|error| SessionEnd::Link(error.to_string()))?;
        }
        Ok(())
    }
}

/// Forgets what was learned under the name of a device if that was another board.
fn recognise_board(
    store: &mut Store,
    learner: &Learner,
    (name, device): (&str, DeviceId),
    chip: &str,
) -> Result<(), StoreError> {
    let Some(before) = store.set_chip(device, chip)? else {
        return Ok(());
    };
    learner.forget_board(name);
    let text =
        format!("another board, chip {chip}: what was learned of chip {before} is forgotten");
    tracing::warn!(device = name, text);
    store.event(Some(device), "learned", &text)
}
