//! Rows of one device's lookups in the store.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{Certainty, DeviceId, LookupRow};

use super::reconcile::previous_lookup;
use super::store_wait::StoreWait;
use crate::learning::LookupToPush;

/// Reason given where the store does not respond.
const SILENT: &str = "the store does not answer";

/// Race of the store, which gets to a request late, with the end of the wait for it: what the first has decided holds for both.
#[derive(Clone, Default)]
struct Decision(Arc<AtomicBool>);

impl Decision {
    /// Decides; returns `true` for the first.
    fn take(&self) -> bool {
        !self.0.swap(true, Ordering::Relaxed)
    }

    /// Leaves it to the other after all.
    fn give_back(&self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// Lookups of one device in the store. Errors of the store are reported by its thread.
pub struct LookupRows<'a> {
    /// Name of the device.
    pub name: &'a str,
    /// Waits of the device's task for the store.
    pub wait: Arc<StoreWait>,
    /// Row of the device; `None` until it is stored.
    pub device_id: Option<DeviceId>,
}

impl LookupRows<'_> {
    /// Returns the rows, oldest first; `None` if the store does not respond.
    pub async fn read(&self) -> Option<Vec<LookupRow>> {
        let device = self.device_id?;
        let rows = self.wait.run(move |store| store.lookups(device));
        rows.await
    }

    /// Returns the lookup of this version, the inner `None` if the store holds none; `None` if the store does not respond.
    async fn of_version(&self, version: u32) -> Option<Option<RlLookup>> {
        let name = self.name.to_owned();
        let row = self
            .wait
            .run(move |store| store.lookup(&name, Some(version)));
        let row = row.await?;
        Some(row.and_then(|row| RlLookup::from_bytes(&row.blob).ok()))
    }

    /// Returns the lookup of this version; for `None` the one that was active before `on_device`, the present one.
    ///
    /// # Errors
    /// Reason why there is none.
    pub async fn find(&self, version: Option<u32>, on_device: u32) -> Result<LookupToPush, String> {
        let lookup = match version {
            // The built-in lookup, which the store may not hold.
            Some(0) => Some(prior()),
            Some(version) => self.of_version(version).await.ok_or(SILENT)?,
            None => previous_lookup(on_device, &self.read().await.ok_or(SILENT)?),
        };
        let lookup = lookup.ok_or_else(|| match version {
            Some(version) => format!("the store holds no lookup of version {version}"),
            None => "the store holds no lookup that was active before".to_owned(),
        })?;
        let (name, version) = (self.name.to_owned(), lookup.version);
        let certainty = self.wait.run(move |store| store.certainty(&name, version));
        Ok(LookupToPush {
            certainty: certainty.await.flatten(),
            lookup,
        })
    }

    /// Stores a lookup as pending. Returns `None` if it is not stored, nor will be when the store gets to it.
    pub async fn pend(
        &self,
        lookup: &RlLookup,
        why: String,
        certainty: Option<Certainty>,
    ) -> Option<()> {
        let (device, pending) = (self.device_id?, lookup.clone());
        let decision = Decision::default();
        let of_store = decision.clone();
        let stored = self.wait.run(move |store| {
            store.pend_lookup(device, &pending, &why, certainty.as_ref())?;
            match of_store.take() {
                true => Ok(()),
                false => store.refuse_lookup(device, pending.version, "the store was too slow"),
            }
        });
        (stored.await.is_some() || !decision.take()).then_some(())
    }

    /// Marks a pending lookup as refused. If the store fails, it stays pending until the next connection reconciles it.
    pub async fn refuse(&self, version: u32, why: String) {
        let Some(device) = self.device_id else { return };
        let refused = self
            .wait
            .run(move |store| store.refuse_lookup(device, version, &why));
        let _ = refused.await;
    }

    /// Makes the device's lookup the active one. Returns `None` if that is not stored.
    pub async fn adopt(&self, lookup: RlLookup) -> Option<()> {
        let device = self.device_id?;
        let adopted = self
            .wait
            .run(move |store| store.adopt_lookup(device, &lookup));
        adopted.await
    }

    /// Forgets what was learned and makes the built-in lookup the active one. Returns `None` if that is not stored, nor will be when the
    /// store gets to it.
    pub async fn reset(&self) -> Option<()> {
        let device = self.device_id?;
        let decision = Decision::default();
        let of_store = decision.clone();
        let reset = self.wait.run(move |store| {
            let reset = store.reset_learning(device, &prior(), || of_store.take());
            if reset.is_err() {
                of_store.give_back();
            }
            reset.map(drop)
        });
        (reset.await.is_some() || !decision.take()).then_some(())
    }
}
