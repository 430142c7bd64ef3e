//! Captures in the fleet's object store.

use std::path::Path;

use async_nats::jetstream::Context;
use async_nats::jetstream::object_store::ObjectStore;
use futures_util::StreamExt;
use serde::Serialize;
use tokio::io::AsyncWriteExt;

use crate::jetstream::{self, JetStreamError};
use crate::names;

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

/// Uploads a file as `name`; returns its size in bytes.
///
/// # Errors
/// [`JetStreamError`] if the file cannot be read or the server refuses it.
pub async fn put(context: &Context, path: &Path, name: &str) -> Result<u64, JetStreamError> {
    let store = store(context).await?;
    let mut file = tokio::fs::File::open(path).await.map_err(failed)?;
    let info = store.put(name, &mut file).await.map_err(failed)?;
    Ok(info.size as u64)
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
