//! Captures in the fleet's object store.

use std::collections::BTreeSet;
use std::path::Path;

use async_nats::jetstream::Context;
use async_nats::jetstream::object_store::ObjectStore;
use futures_util::StreamExt;
use serde::Serialize;
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};

use crate::jetstream::{self, JetStreamError};
use crate::names;

/// Largest chunk of the client in bytes.
const CHUNK_BYTES: u64 = 128 * 1_024;

/// Shortest beginning, in bytes, by which a chunk is known as a file's.
const MIN_CHUNK_BYTES: usize = 4_096;

/// A capture in the fleet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FleetCapture {
    /// Its name.
    pub name: String,
    /// Size in bytes.
    pub bytes: u64,
    /// Time of the upload in seconds since 1970, UTC; `None` if the server does not report it.
    pub at_s: Option<i64>,
}

async fn store(context: &Context) -> Result<ObjectStore, JetStreamError> {
    let store = context.get_object_store(names::CAPTURES).await;
    store.map_err(|e| jetstream::missing(names::CAPTURES, e))
}

fn failed<E: std::fmt::Display>(e: E) -> JetStreamError {
    JetStreamError::new(names::CAPTURES, e)
}

/// Lists the captures, sorted by name.
///
/// # Errors
/// [`JetStreamError`].
pub async fn list(context: &Context) -> Result<Vec<FleetCapture>, JetStreamError> {
    let mut captures = Vec::new();
    let store = store(context).await?;
    let mut list = store.list().await.map_err(failed)?;
    while let Some(info) = list.next().await {
        let info = info.map_err(failed)?;
        captures.push(FleetCapture {
            name: info.name,
            bytes: info.size as u64,
            at_s: info.modified.map(|at| at.unix_timestamp()),
        });
    }
    captures.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(captures)
}

/// Uploads a file as `name`; returns its size in bytes. What a failed or killed upload of the file has left on the server is removed.
///
/// # Errors
/// [`JetStreamError`] if the file cannot be read, has no room, or the server refuses it.
pub async fn put(context: &Context, path: &Path, name: &str) -> Result<u64, JetStreamError> {
    let store = store(context).await?;
    let mut file = tokio::fs::File::open(path).await.map_err(failed)?;
    let bytes = file.metadata().await.map_err(failed)?.len();
    let mut head = Vec::new();
    let first = (&mut file).take(CHUNK_BYTES).read_to_end(&mut head).await;
    first.map_err(failed)?;
    file.rewind().await.map_err(failed)?;
    remove_remains(context, &store, &head).await?;
    check_free_bytes(context, bytes).await?;
    match store.put(name, &mut file).await {
        Ok(info) => Ok(info.size as u64),
        Err(why) => {
            remove_remains(context, &store, &head).await?;
            Err(failed(why))
        }
    }
}

/// Checks that an upload of so many bytes has room: the server would keep its first part and refuse the rest.
async fn check_free_bytes(context: &Context, bytes: u64) -> Result<(), JetStreamError> {
    let stream = jetstream::stream(context, names::CAPTURES_STREAM).await?;
    let info = stream.cached_info();
    let Ok(most) = u64::try_from(info.config.max_bytes) else {
        return Ok(());
    };
    // Subjects, headers and checksums of its messages.
    let needed = bytes + bytes / 128 + 4_096;
    let free = most.saturating_sub(info.state.bytes);
    match needed <= free {
        true => Ok(()),
        false => Err(failed(format!(
            "{bytes} bytes do not fit: {free} of {most} are free; `ihd-fleet init --captures-bytes` makes more room"
        ))),
    }
}

/// Removes chunks that begin as a file does and belong to no capture.
async fn remove_remains(
    context: &Context,
    store: &ObjectStore,
    head: &[u8],
) -> Result<(), JetStreamError> {
    let mut captures = store.list().await.map_err(failed)?;
    let mut known = BTreeSet::new();
    while let Some(info) = captures.next().await {
        known.insert(info.map_err(failed)?.nuid);
    }
    let stream = jetstream::stream(context, names::CAPTURES_STREAM).await?;
    let prefix = format!("$O.{}.C.", names::CAPTURES);
    let subjects = stream.info_with_subjects(format!("{prefix}>")).await;
    let mut subjects = subjects.map_err(failed)?;
    while let Some(next) = subjects.next().await {
        let (subject, _) = next.map_err(failed)?;
        if subject
            .strip_prefix(&prefix)
            .is_none_or(|nuid| known.contains(nuid))
        {
            continue;
        }
        let first = stream.direct_get_next_for_subject(&*subject, None).await;
        // Another upload may have ended meanwhile.
        let Ok(first) = first else { continue };
        let begins = first.payload.len() >= MIN_CHUNK_BYTES.min(head.len())
            && head.starts_with(&first.payload);
        if begins && !first.payload.is_empty() {
            let removed = stream.purge().filter(&subject).await;
            removed.map_err(failed)?;
        }
    }
    Ok(())
}

/// Downloads a capture into a new file; returns its size in bytes. A partial download stays as `PATH.part` and is overwritten by the next try.
///
/// # Errors
/// [`JetStreamError`] if there is no capture of that name, it is damaged, or the file exists or cannot be written.
pub async fn get(context: &Context, name: &str, path: &Path) -> Result<u64, JetStreamError> {
    if path.exists() {
        return Err(failed(format!("{} is there already", path.display())));
    }
    let store = store(context).await?;
    let mut object = store.get(name).await.map_err(failed)?;
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let mut file = tokio::fs::File::create(&part).await.map_err(failed)?;
    let bytes = tokio::io::copy(&mut object, &mut file)
        .await
        .map_err(failed)?;
    file.flush().await.map_err(failed)?;
    file.sync_all().await.map_err(failed)?;
    tokio::fs::rename(&part, path).await.map_err(failed)?;
    Ok(bytes)
}
