//! Lookups in the fleet: what a hob uses goes there, under its key, with its history; what somebody else puts there is pushed to the hob.
//!
//! Each put names the revision that it follows (compare-and-set): of two who write at once one is told, looks again, and no lookup is
//! overwritten unseen.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::kv;
use futures_util::stream::{SelectAll, StreamExt};
use ihd_daemon::model::{Command, What};
use ihd_shared::lookup::RlLookup;
use tokio::sync::broadcast::error::RecvError;

use super::{Link, TRY_AGAIN};
use crate::engine;
use crate::lookups::LookupMessage;
use crate::names;

/// Who commands the daemon's devices in the fleet's name.
const HOLDER: &str = "fleet";

/// Between two looks where nothing was heard of.
const LOOK_EVERY: Duration = Duration::from_secs(30);

/// What is known of the fleet's entry of a hob.
#[derive(Default)]
struct Known {
    revision: u64,
    /// The lookup that was put or tried last.
    blob: Vec<u8>,
}

/// Follows both until the edge ends.
pub async fn run(link: Arc<Link>) {
    loop {
        if link.is_connected() && link.serves() {
            match link.unless_stopping(follow(&link)).await {
                None => return,
                Some(Err(why)) => link.failed("lookups", &why),
                Some(Ok(())) => {}
            }
        }
        if !link.wait(TRY_AGAIN).await {
            return;
        }
    }
}

async fn follow(link: &Link) -> Result<(), String> {
    let bucket = engine::bucket(&link.context, names::LOOKUPS).await;
    let bucket = bucket.map_err(|e| e.to_string())?;
    let hobs = link.hobs();
    let client = link.context.client();
    // A hint alone: refused puts are heard, too.
    let mut hints = SelectAll::new();
    for hob in &hobs {
        let heard = client.subscribe(names::key(names::LOOKUPS, hob)).await;
        hints.push(heard.map_err(|e| e.to_string())?);
    }
    let mut notices = link.daemon.watch();
    let mut known: BTreeMap<String, Known> = BTreeMap::new();
    let mut changed: Vec<String> = hobs.clone();
    while link.is_connected() && link.hobs() == hobs {
        for hob in std::mem::take(&mut changed) {
            let known = known.entry(hob.clone()).or_default();
            settle(link, &bucket, &hob, known).await?;
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK_EVERY) => changed = hobs.clone(),
            hint = hints.next(), if !hobs.is_empty() => {
                let hint = hint.ok_or("the subscription ended")?;
                changed.extend(hint.subject.split('.').next_back().map(str::to_owned));
            }
            notice = notices.recv() => match notice {
                Ok(notice) if matches!(notice.what, What::LookupActive { .. }) => {
                    changed.push(notice.device.clone());
                }
                Ok(_) => {}
                Err(RecvError::Lagged(_)) => changed = hobs.clone(),
                Err(RecvError::Closed) => std::future::pending().await,
            }
        }
    }
    Ok(())
}

/// Brings a hob and the fleet's entry of it together: what somebody wants used is pushed, else the fleet gets what is in use.
async fn settle(
    link: &Link,
    bucket: &kv::Store,
    hob: &str,
    known: &mut Known,
) -> Result<(), String> {
    let rows = link.daemon.lookups(hob).await;
    let rows = rows.map_err(|e| e.to_string())?;
    let active = rows
        .iter()
        .rfind(|row| row.state == ihd_store::LookupState::Active);
    let entry = bucket.entry(hob).await.map_err(|e| e.to_string())?;
    let revision = entry.as_ref().map_or(0, |entry| entry.revision);
    let message = entry
        .filter(|entry| entry.operation == kv::Operation::Put)
        .and_then(|entry| serde_json::from_slice::<LookupMessage>(&entry.value).ok());
    if let Some(wanted) = message.as_ref().filter(|m| !m.in_use) {
        if known.revision == revision {
            // Tried before: it is told, and the hob goes on with what it has.
            return Ok(());
        }
        known.revision = revision;
        let outcome = push(link, hob, wanted).await;
        let by = &wanted.by;
        match outcome {
            Ok(said) => tracing::info!(hob, by, said, "a lookup of the fleet is in use"),
            Err(why) => link.failed(&format!("lookup of {by} for {hob}"), &why),
        }
        return Ok(());
    }
    let Some(active) = active else { return Ok(()) };
    let lookup = RlLookup::from_bytes(&active.blob).map_err(|e| e.to_string())?;
    let there = message.and_then(|m| m.blob().ok());
    if there.as_deref() == Some(&active.blob[..]) || known.blob == active.blob {
        return Ok(());
    }
    let message = LookupMessage::new(&lookup, &link.edge, true);
    let value = serde_json::to_vec(&message).map_err(|e| e.to_string())?;
    match bucket.update(hob, value.into(), revision).await {
        Ok(revision) => {
            known.revision = revision;
            known.blob = active.blob.clone();
            Ok(())
        }
        // Somebody was faster: the hint of that brings us here again.
        Err(e) if e.kind() == kv::UpdateErrorKind::WrongLastRevision => Ok(()),
        Err(e) => Err(e.to_string()),
    }
}

async fn push(link: &Link, hob: &str, wanted: &LookupMessage) -> Result<String, String> {
    let command = Command::LookupPush {
        blob: wanted.blob()?,
    };
    let done = link.daemon.command(hob, HOLDER, command).await;
    done.map(|done| done.text).map_err(|e| e.to_string())
}
