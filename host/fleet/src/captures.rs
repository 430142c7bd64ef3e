//! Captures in the fleet's object store.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use async_nats::jetstream::object_store::ObjectStore;
use futures_util::StreamExt;
use serde::Serialize;
use tokio::io::AsyncWriteExt;

use crate::edge::Link;
use crate::engine::{self, EngineError};
use crate::names;

/// Between two looks for a recording that is finished.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// A capture in the fleet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Capture {
    /// Its name.
    pub name: String,
    /// Bytes.
    pub bytes: u64,
    /// When it was put there, in seconds since 1970, UTC; none where the server does not say.
    pub at_s: Option<i64>,
}

async fn store(context: &Context) -> Result<ObjectStore, EngineError> {
    let store = context.get_object_store(names::CAPTURES).await;
    store.map_err(|e| engine::missing(names::CAPTURES, e))
}

fn failed<E: std::fmt::Display>(e: E) -> EngineError {
    EngineError::new(names::CAPTURES, e)
}

/// What is there, by name.
///
/// # Errors
/// [`EngineError`].
pub async fn list(context: &Context) -> Result<Vec<Capture>, EngineError> {
    let mut found = Vec::new();
    let store = store(context).await?;
    let mut list = store.list().await.map_err(failed)?;
    while let Some(info) = list.next().await {
        let info = info.map_err(failed)?;
        found.push(Capture {
            name: info.name,
            bytes: info.size as u64,
            at_s: info.modified.map(|at| at.unix_timestamp()),
        });
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// Puts a file there, under its own name or `name`.
///
/// # Errors
/// [`EngineError`]: the file cannot be read, or the server refuses it.
pub async fn put(context: &Context, path: &Path, name: &str) -> Result<u64, EngineError> {
    let store = store(context).await?;
    let mut file = tokio::fs::File::open(path).await.map_err(failed)?;
    let info = store.put(name, &mut file).await.map_err(failed)?;
    Ok(info.size as u64)
}

/// Gets one into a file that is not there yet. A part of one stays under another name, and is deleted at the next try.
///
/// # Errors
/// [`EngineError`]: there is none of that name, it is damaged, or the file cannot be written.
pub async fn get(context: &Context, name: &str, path: &Path) -> Result<u64, EngineError> {
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

/// Puts every recording of an edge there that is finished, once, as `EDGE/FILE`.
pub(crate) async fn follow(link: Arc<Link>, context: Context) {
    let mut there: BTreeSet<String> = BTreeSet::new();
    let mut known = false;
    loop {
        if link.is_admitted() {
            if !known {
                let listed = list(&context).await;
                known = listed.is_ok();
                there.extend(listed.unwrap_or_default().into_iter().map(|c| c.name));
            }
            if known {
                match put_new(&link, &context, &mut there).await {
                    Ok(()) => link.works("captures"),
                    Err(why) => link.failed("captures", &why),
                }
            }
        }
        if !link.wait(LOOK_EVERY).await {
            return;
        }
    }
}

async fn put_new(
    link: &Link,
    context: &Context,
    there: &mut BTreeSet<String>,
) -> Result<(), EngineError> {
    let recordings = link.daemon.recordings().await.map_err(failed)?;
    for recording in recordings.into_iter().filter(|r| !r.under_way) {
        let name = format!("{}/{}", link.edge, recording.file);
        if there.contains(&name) {
            continue;
        }
        let path = link.daemon.recordings_folder().join(&recording.file);
        let bytes = put(context, &path, &name).await?;
        tracing::info!(name, bytes, "a recording is in the fleet");
        there.insert(name);
    }
    Ok(())
}
