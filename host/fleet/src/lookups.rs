//! Lookups in the fleet, for whoever looks at them or wants one used.

use async_nats::jetstream::{Context, kv};
use futures_util::StreamExt;
use ihd_shared::lookup::RlLookup;
use serde::{Deserialize, Serialize};

use crate::edge::now_ms;
use crate::engine::{self, EngineError};
use crate::names;

/// A lookup in the fleet (JSON): the value of a hob's key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LookupMessage {
    /// Its version.
    pub version: u32,
    /// Who put it there: the edge whose hob uses it, or who wants it used.
    pub by: String,
    /// Whether the hob uses it; else it is to.
    pub in_use: bool,
    /// When, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// As it is pushed, in hexadecimal digits.
    pub blob: String,
}

impl LookupMessage {
    /// Of a lookup.
    pub fn new(lookup: &RlLookup, by: &str, in_use: bool) -> Self {
        let bytes = lookup.to_bytes();
        Self {
            version: lookup.version,
            by: by.to_owned(),
            in_use,
            at_ms: now_ms(),
            blob: bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        }
    }

    /// The lookup, as it is pushed.
    ///
    /// # Errors
    /// Why it is none.
    pub fn blob(&self) -> Result<Vec<u8>, String> {
        let digits = self.blob.as_bytes();
        let byte = |pair: &[u8]| {
            let text = std::str::from_utf8(pair).ok()?;
            u8::from_str_radix(text, 16).ok()
        };
        let bytes: Option<Vec<u8>> = digits.chunks(2).map(byte).collect();
        let bytes = bytes.ok_or("its lookup is not in hexadecimal digits")?;
        RlLookup::from_bytes(&bytes).map_err(|e| e.to_string())?;
        Ok(bytes)
    }
}

/// A lookup of the history.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Entry {
    /// The hob's name.
    pub hob: String,
    /// Its number in the bucket.
    pub revision: u64,
    /// The lookup.
    pub lookup: LookupMessage,
}

fn failed<E: std::fmt::Display>(e: E) -> EngineError {
    EngineError::new(names::LOOKUPS, e)
}

/// The last lookup of each hob, by name.
///
/// # Errors
/// [`EngineError`].
pub async fn all(context: &Context) -> Result<Vec<Entry>, EngineError> {
    let mut found = Vec::new();
    for hob in engine::entries(context, names::LOOKUPS).await?.into_keys() {
        found.extend(history(context, &hob).await?.pop());
    }
    Ok(found)
}

/// The lookups of a hob that are remembered, oldest first.
///
/// # Errors
/// [`EngineError`].
pub async fn history(context: &Context, hob: &str) -> Result<Vec<Entry>, EngineError> {
    let bucket = engine::bucket(context, names::LOOKUPS).await?;
    let mut history = bucket.history(hob).await.map_err(failed)?;
    let mut found = Vec::new();
    while let Some(entry) = history.next().await {
        let entry = entry.map_err(failed)?;
        let read = serde_json::from_slice(&entry.value);
        let (kv::Operation::Put, Ok(lookup)) = (entry.operation, read) else {
            continue;
        };
        found.push(Entry {
            hob: hob.to_owned(),
            revision: entry.revision,
            lookup,
        });
    }
    Ok(found)
}

/// Has a hob use a lookup: its edge pushes it. The entry's new revision.
///
/// # Errors
/// [`EngineError`]: the server says no, or somebody else has put one meanwhile.
pub async fn want(
    context: &Context,
    hob: &str,
    lookup: &RlLookup,
    by: &str,
) -> Result<u64, EngineError> {
    let bucket = engine::bucket(context, names::LOOKUPS).await?;
    let entry = bucket.entry(hob).await.map_err(failed)?;
    let revision = entry.map_or(0, |entry| entry.revision);
    let value = serde_json::to_vec(&LookupMessage::new(lookup, by, false)).map_err(failed)?;
    let put = bucket.update(hob, value.into(), revision).await;
    put.map_err(|e| match e.kind() {
        kv::UpdateErrorKind::WrongLastRevision => failed(format!(
            "somebody else has put a lookup of {hob} meanwhile: look at it, and try again"
        )),
        _ => failed(e),
    })
}

#[cfg(test)]
mod tests {
    use ihd_shared::lookup::prior::prior;

    use super::*;

    #[test]
    fn a_lookup_travels_and_what_is_none_is_refused() {
        let message = LookupMessage::new(&prior(), "lab", true);
        assert_eq!(message.blob().unwrap(), prior().to_bytes());
        for blob in ["", "0", "zz", &message.blob[2..]] {
            let wrong = LookupMessage {
                blob: blob.to_owned(),
                ..message.clone()
            };
            assert!(wrong.blob().is_err(), "{blob:?}");
        }
    }
}
