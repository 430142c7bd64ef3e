//! Lookups on their way to the device: pending in the store, pushed, active when the device says so.

use std::time::Duration;

use ihd_link::{Client, LinkError};
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_store::{Confidence, LookupRow};
use tokio::time::Instant;

use super::Answer;
use super::lookups::{Mend, mend, next_version};
use super::session::Session;
use crate::learning::Lookup;
use crate::model::{CommandError, Done, What};
use crate::printable::printable;

/// How long a device may take from accepting a lookup to using it: a half-cycle, and what the link needs.
const ACTIVE_WITHIN: Duration = Duration::from_secs(3);

/// A lookup that the device took and does not use yet.
pub struct Push {
    lookup: RlLookup,
    until: Instant,
    is_learned: bool,
    answer: Option<Answer>,
}

impl Session<'_> {
    /// Both sides after a connection was made.
    pub(super) async fn reconcile(&mut self, on_device: u32) -> Result<(), LinkError> {
        self.face.lock().lookup.on_device = Some(on_device);
        let lookup = match self.ask(Client::read_lookup).await {
            Ok(lookup) => lookup,
            Err(error @ LinkError::DamagedLookup { .. }) => {
                tracing::warn!(device = self.face.name, %error, "lookup");
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let Some(rows) = self.rows().await else {
            self.owes_mending = true;
            return Ok(());
        };
        self.context
            .learner
            .set_device_version(&self.face.name, on_device);
        for step in mend(&lookup, &rows) {
            match step {
                Mend::Nothing => {}
                Mend::Activate(_) | Mend::Adopt => self.adopt(&lookup).await,
                Mend::Push(lookup, why) => {
                    let lookup = Lookup::without_confidence(*lookup);
                    let _ = self.push(lookup, why, None).await;
                }
            }
        }
        self.show_lookups().await;
        Ok(())
    }

    /// What the store holds; none where it cannot say.
    pub(super) async fn rows(&self) -> Option<Vec<LookupRow>> {
        let device = self.device?;
        let rows = self.context.in_store(move |store| store.lookups(device));
        rows.await
    }

    /// The store learns what the device uses.
    async fn adopt(&mut self, lookup: &RlLookup) {
        let Some(device) = self.device else { return };
        let (version, observed_cells) = (lookup.version, lookup.observed_cells());
        let lookup = lookup.clone();
        let adopted = self
            .context
            .in_store(move |store| store.adopt_lookup(device, &lookup))
            .await;
        if adopted.is_none() {
            // The store has it as pending, and is told again.
            self.owes_mending = true;
        } else if version > 0 {
            tracing::info!(
                device = self.face.name,
                version,
                observed_cells,
                "lookup active"
            );
            self.face.tell(What::LookupActive {
                version,
                observed_cells,
            });
        }
        self.show_lookups().await;
    }

    /// Pushes a lookup, under the next version where the device would not take its own: pending in the store before the device sees it. `answer` is
    /// told when it is active, or why not.
    ///
    /// # Errors
    /// What to say to whoever asked where there is no `answer`; a refusal is a state, not an end.
    pub(super) async fn push(
        &mut self,
        pushed: Lookup,
        why: &str,
        answer: Option<Answer>,
    ) -> Result<(), String> {
        let Lookup {
            mut lookup,
            confidence,
        } = pushed;
        let outcome = self.try_push(&mut lookup, confidence, why).await;
        let version = lookup.version;
        match outcome {
            Ok(()) => {
                self.forget_push();
                self.push = Some(Push {
                    lookup,
                    until: Instant::now() + ACTIVE_WITHIN,
                    is_learned: false,
                    answer,
                });
                Ok(())
            }
            Err(why) => {
                let why = printable(&why);
                tracing::warn!(device = self.face.name, version, why, "lookup refused");
                self.face.tell(What::LookupRefused {
                    version,
                    why: why.clone(),
                });
                self.refuse(answer, &why);
                self.show_lookups().await;
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
        let device = self.device.ok_or(
            "the store does not know the device: nothing is pushed that it could not keep",
        )?;
        let rows = self
            .rows()
            .await
            .ok_or("the store does not answer: nothing is pushed that it could not keep")?;
        let on_device = self.face.lock().lookup.on_device.unwrap_or(0);
        let highest = on_device.saturating_add(LOOKUP_VERSION_STEP);
        if lookup.version <= on_device || lookup.version > highest {
            lookup.version = next_version(on_device, &rows)?;
        }
        let (pending, said) = (lookup.clone(), printable(why));
        let pended = self
            .context
            .in_store(move |store| store.pend_lookup(device, &pending, &said, confidence.as_ref()));
        let not_kept = "the store cannot keep it: nothing is pushed that it does not know";
        pended.await.ok_or(not_kept)?;
        let version = lookup.version;
        self.face.lock().lookup.pending = Some(version);
        let pushed = lookup.clone();
        match self.ask(move |client| client.push_lookup(&pushed)).await {
            Ok(()) => Ok(()),
            Err(error @ LinkError::Refused { .. }) => {
                let said = error.to_string();
                let refused = self
                    .context
                    .in_store(move |store| store.refuse_lookup(device, version, &said));
                // It stays pending, and the next connection asks the device.
                let _ = refused.await;
                Err(error.to_string())
            }
            // Whether the device has it is found out at the next connection.
            Err(error) => Err(error.to_string()),
        }
    }

    /// A lookup that was learned: pushed when nothing else is on its way. A newer one takes its place.
    pub(super) async fn on_news(&mut self, lookup: Box<Lookup>) {
        self.news = Some(lookup);
        self.push_news().await;
    }

    /// Pushes what was learned, where it may be pushed now.
    pub(super) async fn push_news(&mut self) {
        if self.push.is_some() {
            return;
        }
        let Some(lookup) = self.news.take() else {
            return;
        };
        let version = lookup.lookup.version;
        let pushed = self.push(*lookup, "learned", None).await;
        match &mut self.push {
            // Under another version, where the device was given one meanwhile.
            Some(push) => push.is_learned = push.lookup.version == version,
            None => {
                debug_assert!(pushed.is_err());
                self.context
                    .learner
                    .lookup_refused(&self.face.name, version);
            }
        }
    }

    /// The device uses this version now: what was pushed may be active.
    pub(super) async fn is_pushed(&mut self, version: u32) {
        let Some(push) = self.push.take_if(|push| push.lookup.version == version) else {
            return;
        };
        // Activates what is pending, bit for bit.
        self.adopt(&push.lookup).await;
        let (learner, name) = (&self.context.learner, &self.face.name);
        match push.is_learned {
            true => learner.lookup_accepted(name, version),
            false => learner.set_device_version(name, version),
        }
        if let Some(answer) = push.answer {
            let _ = answer.send(Ok(Done {
                text: format!("version {version} is active"),
                file: None,
            }));
        }
    }

    /// A device that took a lookup and does not use it.
    pub(super) async fn is_overdue(&mut self) {
        let Some(push) = self.push.take_if(|push| Instant::now() >= push.until) else {
            return;
        };
        let version = push.lookup.version;
        if push.is_learned {
            self.context
                .learner
                .lookup_refused(&self.face.name, version);
        }
        let why = "the device took it and does not use it";
        tracing::warn!(device = self.face.name, version, why, "lookup");
        self.face.tell(What::LookupRefused {
            version,
            why: why.to_owned(),
        });
        self.refuse(push.answer, why);
    }

    /// The session ends, or another lookup takes its place: what became of it is found out later.
    pub(super) fn forget_push(&mut self) {
        if let Some(push) = self.push.take() {
            self.refuse(
                push.answer,
                "it was pushed, and the link ended before the device used it",
            );
        }
    }

    /// Back to the built-in lookup.
    pub(super) async fn reset_lookup(&mut self) -> Result<(), LinkError> {
        self.ask(Client::reset_lookup).await?;
        self.forget_push();
        self.news = None;
        self.context.learner.forget(&self.face.name);
        self.context.learner.set_device_version(&self.face.name, 0);
        if let Some(device) = self.device {
            let forgotten = self.context.in_store(move |store| {
                store.forget_learner_state(device)?;
                store.adopt_lookup(device, &prior())
            });
            self.owes_mending = forgotten.await.is_none();
        }
        self.show_lookups().await;
        Ok(())
    }

    /// What the store holds, for the report.
    pub(super) async fn show_lookups(&mut self) {
        let Some(rows) = self.rows().await else {
            return;
        };
        let of = |state| rows.iter().rev().find(|row| row.state == state);
        let active = of(ihd_store::LookupState::Active);
        let lookup = active.and_then(|row| RlLookup::from_bytes(&row.blob).ok());
        let mut inner = self.face.lock();
        inner.lookup.active = active.map(|row| row.version);
        inner.lookup.pending = of(ihd_store::LookupState::Pending).map(|row| row.version);
        inner.lookup.observed_cells = lookup.map_or(0, |l| l.observed_cells());
    }

    fn refuse(&self, answer: Option<Answer>, why: &str) {
        if let Some(answer) = answer {
            let _ = answer.send(Err(CommandError::Refused {
                name: self.face.name.clone(),
                why: why.to_owned(),
            }));
        }
    }
}
