//! Lookups in the fleet: the lookup that a hob uses is put under the hob's key, with a history; a lookup requested there is pushed to the hob.
//!
//! Each put names the revision that it follows (compare-and-set): of two simultaneous writers one is refused and reads again, so that no
//! lookup is overwritten unseen.

use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::{Context, kv};
use futures_util::stream::{SelectAll, StreamExt};
use ihd_daemon::fleet::LookupCheck;
use ihd_model::{Command, DeviceState, EventKind};
use ihd_shared::lookup::RlLookup;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::Instant;

use super::link::Link;
use super::refusals::RETRY_PAUSE;
use crate::clock::now_ms;
use crate::jetstream;
use crate::lookups::LookupMessage;
use crate::names;

/// Holder of commands to the daemon's devices on behalf of the fleet.
const HOLDER: &str = "fleet";

/// Part of which failures are recorded.
const PART: &str = "lookups";

/// Period of polling without hints.
const POLL_PERIOD: Duration = Duration::from_secs(5);

/// Longest age of a request that is still pushed, by the server's time: another pot may stand there later.
const REQUEST_VALID_MS: i64 = 24 * 3_600_000;

/// Reason of the refusal of an older one.
const TOO_OLD: &str = "it was requested more than a day ago: push it again";

/// Reconciles hobs and fleet until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    while link
        .turn_until_stop(PART, RETRY_PAUSE, follow(&link, &context))
        .await
    {}
}

/// Reconciles as long as the edge is admitted; returns the pause before the next attempt.
async fn follow(link: &Link, context: &Context) -> Result<Duration, String> {
    if !link.is_admitted() {
        return Ok(RETRY_PAUSE);
    }
    let bucket = jetstream::bucket(context, names::LOOKUPS).await;
    let bucket = bucket.map_err(|e| e.to_string())?;
    let hobs = link.hobs();
    let client = context.client();
    // Only hints: refused puts arrive, too, and all before the server has stored them.
    let mut hints = SelectAll::new();
    for hob in &hobs {
        let subscription = client.subscribe(names::key(names::LOOKUPS, hob)).await;
        hints.push(subscription.map_err(|e| e.to_string())?);
    }
    let mut notices = link.daemon.watch();
    let mut changed: Vec<String> = hobs.clone();
    let mut poll = tokio::time::interval(POLL_PERIOD);
    link.works(PART);
    while link.is_admitted() && link.hobs() == hobs {
        for hob in std::mem::take(&mut changed) {
            let began = Instant::now();
            // The next poll comes back to a hob that waits.
            if link.may_try(PART, &hob) {
                match reconcile(link, &bucket, &hob).await {
                    Ok(()) => link.accepted(PART, &hob),
                    Err(why) => link.refused(PART, &hob, &why, began),
                }
            }
        }
        tokio::select! {
            // An interval, since a pause would begin anew with each notice.
            _ = poll.tick() => changed = hobs.clone(),
            hint = hints.next(), if !hobs.is_empty() => {
                let hint = hint.ok_or("the subscription ended")?;
                changed.extend(hint.subject.split('.').next_back().map(str::to_owned));
            }
            notice = notices.recv() => match notice {
                Ok(notice) if matches!(notice.kind, EventKind::LookupActive { .. }) => {
                    changed.push(notice.device.clone());
                }
                Ok(_) => {}
                Err(RecvError::Lagged(_)) => changed = hobs.clone(),
                Err(RecvError::Closed) => std::future::pending().await,
            }
        }
    }
    Ok(RETRY_PAUSE)
}

/// Reconciles a hob with its entry in the fleet: a requested lookup is pushed, once; then the lookup in use is put there. A request that the
/// edge refuses is put back with the reason.
async fn reconcile(link: &Link, bucket: &kv::Store, hob: &str) -> Result<(), String> {
    let entry = bucket.entry(hob).await.map_err(|e| e.to_string())?;
    let revision = entry.as_ref().map_or(0, |entry| entry.revision);
    let entry = entry.filter(|entry| entry.operation == kv::Operation::Put);
    let there: Option<LookupMessage> = (entry.as_ref())
        .map(|entry| serde_json::from_slice(&entry.value))
        .transpose()
        .map_err(|e| {
            format!("its entry cannot be read: {e}; `ihd-fleet lookup push` replaces it")
        })?;
    if let (Some(entry), Some(requested)) =
        (&entry, there.as_ref().filter(|there| there.is_request()))
    {
        let requested_ms = (entry.created.unix_timestamp_nanos() / 1_000_000) as i64;
        let outcome = match now_ms() - requested_ms {
            age_ms if age_ms > REQUEST_VALID_MS => Ok(PushOutcome::Refused(TOO_OLD.to_owned())),
            _ => push(link, hob, requested).await,
        };
        let by = &requested.by;
        match outcome {
            Ok(PushOutcome::InUse(said)) => {
                link.works(PART);
                tracing::info!(hob, by, said, "a lookup of the fleet is in use");
            }
            Ok(PushOutcome::Waits) => return Ok(()),
            Ok(PushOutcome::Refused(why)) => {
                tracing::warn!(hob, by, why, "a lookup of the fleet is refused");
                let refused = LookupMessage {
                    refused: Some(why),
                    ..requested.clone()
                };
                return put(bucket, hob, &refused, revision).await;
            }
            Err(why) => {
                link.failed(PART, &format!("that of {by} for {hob}: {why}"));
                return Ok(());
            }
        }
    }
    let Some(active) = active(link, hob).await? else {
        return Ok(());
    };
    let known = there.filter(|there| there.in_use);
    let known = known.and_then(|there| there.decode().ok());
    if known.as_ref() == Some(&active) {
        return Ok(());
    }
    let message = LookupMessage::new(&active, &link.edge, true);
    put(bucket, hob, &message, revision).await
}

/// Puts a message after a revision. If another put was first, its hint causes the next attempt.
async fn put(
    bucket: &kv::Store,
    hob: &str,
    message: &LookupMessage,
    revision: u64,
) -> Result<(), String> {
    let value = serde_json::to_vec(message).map_err(|e| e.to_string())?;
    match bucket.update(hob, value.into(), revision).await {
        Ok(_) => Ok(()),
        Err(e) if e.kind() == kv::UpdateErrorKind::WrongLastRevision => Ok(()),
        Err(e) => Err(e.to_string()),
    }
}

/// Returns the lookup in use, `None` for the built-in one.
async fn active(link: &Link, hob: &str) -> Result<Option<RlLookup>, String> {
    let active = link.daemon.view().active_lookup(hob).await;
    let active = active.map_err(|e| e.to_string())?;
    let lookup = active.map(|row| RlLookup::from_bytes(&row.blob));
    lookup.transpose().map_err(|e| e.to_string())
}

/// Returns `true` while a hob can take a lookup: it is connected, and nobody else commands it. A command would be refused otherwise, and be
/// logged and audited at each poll.
fn is_free(link: &Link, hob: &str) -> bool {
    use DeviceState::{Incompatible, Searching, Suspended};
    let report = link.daemon.view().device(hob);
    report.is_some_and(|report| {
        let holder = report.lease.map(|lease| lease.holder);
        !matches!(report.state, Searching | Incompatible | Suspended)
            && holder.is_none_or(|holder| holder == HOLDER)
    })
}

/// Outcome of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PushOutcome {
    /// The hob uses the lookup; with the device's text.
    InUse(String),
    /// The hob cannot take it now, or its learning is busy.
    Waits,
    /// The request is not carried out, for this reason.
    Refused(String),
}

/// Pushes a requested lookup unless it contradicts the hob's own observations, or is in use already: if the edge ended before it noted
/// that, the lookup is not pushed again. A hob without observations takes any lookup.
///
/// # Errors
/// Reason for which the hob did not take it; the next attempt may succeed.
pub(super) async fn push(
    link: &Link,
    hob: &str,
    requested: &LookupMessage,
) -> Result<PushOutcome, String> {
    if !is_free(link, hob) {
        return Ok(PushOutcome::Waits);
    }
    let lookup = match requested.decode() {
        Ok(lookup) => lookup,
        Err(why) => return Ok(PushOutcome::Refused(why)),
    };
    let in_use = active(link, hob).await?;
    // The daemon gives a pushed lookup a version of its own.
    let is_same = |active: &RlLookup| {
        RlLookup {
            version: active.version,
            ..lookup.clone()
        } == *active
    };
    if in_use.as_ref().is_some_and(is_same) {
        return Ok(PushOutcome::InUse("it was in use already".to_owned()));
    }
    match link.daemon.fleet().check_lookup(hob, &lookup) {
        LookupCheck::Agrees => {}
        LookupCheck::Unavailable => return Ok(PushOutcome::Waits),
        LookupCheck::Contradicts(place) => {
            return Ok(PushOutcome::Refused(format!(
                "{place}: `ihd device {hob} lookup push builtin` first if another pot stands there"
            )));
        }
    }
    let blob = lookup.to_bytes().to_vec();
    let command = Command::LookupPush { blob };
    let done = link.daemon.command(hob, HOLDER, command).await;
    done.map(|done| PushOutcome::InUse(done.text))
        .map_err(|e| e.to_string())
}
