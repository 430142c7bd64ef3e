//! Lookups in the fleet: present one, history, request of another.

use async_nats::jetstream::{Context, kv};
use futures_util::StreamExt;
use ihd_shared::lookup::RlLookup;
use serde::{Deserialize, Serialize};

use crate::clock::now_ms;
use crate::jetstream::{self, JetStreamError};
use crate::names;

/// Lookup in the fleet (JSON): the value of a hob's key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LookupMessage {
    /// Its version.
    pub version: u32,
    /// Author: the edge whose hob uses it, or the operator who requests it.
    pub by: String,
    /// `true` if the hob uses it, `false` if it is or was requested.
    pub in_use: bool,
    /// Reason for which the edge refused the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Serialised lookup, in hexadecimal digits.
    pub blob: String,
}

impl LookupMessage {
    /// Creates the message of a lookup, with the present time.
    pub fn new(lookup: &RlLookup, by: &str, in_use: bool) -> Self {
        let bytes = lookup.to_bytes();
        Self {
            version: lookup.version,
            by: by.to_owned(),
            in_use,
            refused: None,
            at_ms: now_ms(),
            blob: bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        }
    }

    /// Returns `true` for a request that its edge has not settled.
    pub fn is_request(&self) -> bool {
        !self.in_use && self.refused.is_none()
    }

    /// Returns the lookup.
    ///
    /// # Errors
    /// Text if the digits or the lookup are invalid.
    pub fn decode(&self) -> Result<RlLookup, String> {
        let digits = self.blob.as_bytes();
        let byte = |pair: &[u8]| {
            let text = std::str::from_utf8(pair).ok()?;
            u8::from_str_radix(text, 16).ok()
        };
        let bytes: Option<Vec<u8>> = digits.chunks(2).map(byte).collect();
        let bytes = bytes.ok_or("its lookup is not in hexadecimal digits")?;
        RlLookup::from_bytes(&bytes).map_err(|e| e.to_string())
    }
}

/// Lookup of the history.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LookupEntry {
    /// The hob's name.
    pub hob: String,
    /// Revision in the bucket.
    pub revision: u64,
    /// The lookup.
    pub lookup: LookupMessage,
}

fn failed<E: std::fmt::Display>(e: E) -> JetStreamError {
    JetStreamError::new(names::LOOKUPS, e)
}

/// Returns the last lookup of each hob, sorted by name.
///
/// # Errors
/// [`JetStreamError`].
pub async fn all(context: &Context) -> Result<Vec<LookupEntry>, JetStreamError> {
    let mut entries = Vec::new();
    for hob in jetstream::entries(context, names::LOOKUPS)
        .await?
        .into_keys()
    {
        entries.extend(history(context, &hob).await?.pop());
    }
    Ok(entries)
}

/// Returns the history of a hob, oldest first.
///
/// # Errors
/// [`JetStreamError`].
pub async fn history(context: &Context, hob: &str) -> Result<Vec<LookupEntry>, JetStreamError> {
    let bucket = jetstream::bucket(context, names::LOOKUPS).await?;
    let mut history = bucket.history(hob).await.map_err(failed)?;
    let mut entries = Vec::new();
    while let Some(entry) = history.next().await {
        let entry = entry.map_err(failed)?;
        let read = serde_json::from_slice(&entry.value);
        let (kv::Operation::Put, Ok(lookup)) = (entry.operation, read) else {
            continue;
        };
        entries.push(LookupEntry {
            hob: hob.to_owned(),
            revision: entry.revision,
            lookup,
        });
    }
    Ok(entries)
}

/// Requests that a hob uses a lookup: its edge pushes it. Returns the entry's new revision.
///
/// # Errors
/// [`JetStreamError`] if no edge has such a hob, the server refuses it or another lookup was put meanwhile.
pub async fn request(
    context: &Context,
    hob: &str,
    lookup: &RlLookup,
    by: &str,
) -> Result<u64, JetStreamError> {
    let hobs = jetstream::entries(context, names::HOBS).await?;
    if !hobs.contains_key(hob) {
        let known: Vec<&str> = hobs.keys().map(String::as_str).collect();
        return Err(failed(format!(
            "no edge has a hob {hob:?}; there are: {}",
            known.join(", ")
        )));
    }
    let bucket = jetstream::bucket(context, names::LOOKUPS).await?;
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
        assert_eq!(message.decode(), Ok(prior()));
        for blob in ["", "0", "zz", &message.blob[2..]] {
            let wrong = LookupMessage {
                blob: blob.to_owned(),
                ..message.clone()
            };
            assert!(wrong.decode().is_err(), "{blob:?}");
        }
    }
}
