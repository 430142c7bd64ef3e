//! Lookups in the fleet: what a hob uses goes there, under its key, with its history; what somebody else puts there is pushed to the hob.
//!
//! Each put names the revision that it follows (compare-and-set): of two who write at once one is told, looks again, and no lookup is
//! overwritten unseen.

use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::{Context, kv};
use futures_util::stream::{SelectAll, StreamExt};
use ihd_daemon::fleet::Advice;
use ihd_daemon::model::{Command, What};
use ihd_shared::lookup::RlLookup;
use ihd_store::LookupState;
use tokio::sync::broadcast::error::RecvError;

use super::{Link, TRY_AGAIN};
use crate::engine;
use crate::lookups::LookupMessage;
use crate::names;

/// Who commands the daemon's devices in the fleet's name.
const HOLDER: &str = "fleet";

/// Between two looks where nothing was heard of.
const LOOK_EVERY: Duration = Duration::from_secs(5);

/// Follows both until the edge ends.
pub async fn run(link: Arc<Link>, context: Context) {
    loop {
        if link.is_admitted() {
            match link.unless_stopping(follow(&link, &context)).await {
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

async fn follow(link: &Link, context: &Context) -> Result<(), String> {
    let bucket = engine::bucket(context, names::LOOKUPS).await;
    let bucket = bucket.map_err(|e| e.to_string())?;
    let hobs = link.hobs();
    let client = context.client();
    // A hint alone: refused puts are heard, too, and all before the server has stored them.
    let mut hints = SelectAll::new();
    for hob in &hobs {
        let heard = client.subscribe(names::key(names::LOOKUPS, hob)).await;
        hints.push(heard.map_err(|e| e.to_string())?);
    }
    let mut notices = link.daemon.watch();
    let mut changed: Vec<String> = hobs.clone();
    let mut look = tokio::time::interval(LOOK_EVERY);
    link.works("lookups");
    while link.is_admitted() && link.hobs() == hobs {
        for hob in std::mem::take(&mut changed) {
            settle(link, &bucket, &hob).await?;
        }
        tokio::select! {
            // Beside notices that never end: no pause that begins anew with each.
            _ = look.tick() => changed = hobs.clone(),
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

/// Brings a hob and the fleet's entry of it together: what somebody wants used is pushed, until the hob takes it; else the fleet gets what is
/// in use.
async fn settle(link: &Link, bucket: &kv::Store, hob: &str) -> Result<(), String> {
    let entry = bucket.entry(hob).await.map_err(|e| e.to_string())?;
    let revision = entry.as_ref().map_or(0, |entry| entry.revision);
    let there = entry
        .filter(|entry| entry.operation == kv::Operation::Put)
        .and_then(|entry| serde_json::from_slice::<LookupMessage>(&entry.value).ok());
    if let Some(wanted) = there.as_ref().filter(|there| !there.in_use) {
        let by = &wanted.by;
        match push(link, hob, wanted).await {
            Ok(Some(said)) => {
                link.works("lookups");
                tracing::info!(hob, by, said, "a lookup of the fleet is in use");
            }
            Ok(None) => return Ok(()),
            Err(why) => {
                link.failed("lookups", &format!("that of {by} for {hob}: {why}"));
                return Ok(());
            }
        }
    }
    let Some(active) = active(link, hob).await? else {
        return Ok(());
    };
    let known = there.filter(|there| there.in_use);
    let known = known.and_then(|there| there.blob().ok());
    if known == Some(active.to_bytes().to_vec()) {
        return Ok(());
    }
    let message = LookupMessage::new(&active, &link.edge, true);
    let value = serde_json::to_vec(&message).map_err(|e| e.to_string())?;
    match bucket.update(hob, value.into(), revision).await {
        Ok(_) => Ok(()),
        // Somebody was faster: the hint of that brings us here again.
        Err(e) if e.kind() == kv::UpdateErrorKind::WrongLastRevision => Ok(()),
        Err(e) => Err(e.to_string()),
    }
}

/// The lookup that the hob uses, where it is not the built-in one.
async fn active(link: &Link, hob: &str) -> Result<Option<RlLookup>, String> {
    let rows = link.daemon.lookups(hob).await;
    let rows = rows.map_err(|e| e.to_string())?;
    let active = rows.iter().rfind(|row| row.state == LookupState::Active);
    let lookup = active.map(|row| RlLookup::from_bytes(&row.blob));
    lookup.transpose().map_err(|e| e.to_string())
}

/// Pushes a wanted lookup, if it does not contradict what the hob itself has shown; none where that cannot be told yet.
async fn push(link: &Link, hob: &str, wanted: &LookupMessage) -> Result<Option<String>, String> {
    let blob = wanted.blob()?;
    let lookup = RlLookup::from_bytes(&blob).map_err(|e| e.to_string())?;
    match link.daemon.weigh_lookup(hob, &lookup) {
        Advice::Agrees => {}
        Advice::Later => return Ok(None),
        Advice::Contradicts(place) => {
            return Err(format!(
                "{place}: refused; `ihd device {hob} lookup reset` first if another pot stands there"
            ));
        }
    }
    let command = Command::LookupPush { blob };
    let done = link.daemon.command(hob, HOLDER, command).await;
    done.map(|done| Some(done.text)).map_err(|e| e.to_string())
}
