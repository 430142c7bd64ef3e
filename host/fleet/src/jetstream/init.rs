//! Steps of `ihd-fleet init` on the server: it makes what is missing, applies the limits, deletes nothing.

use async_nats::jetstream::context::{CreateStreamErrorKind, GetStreamErrorKind};
use async_nats::jetstream::{Context, ErrorCode, stream};
use bytes::Bytes;

use super::buckets::bucket;
use super::error::{JetStreamError, failed};
use super::limits::{DAY, FleetLimits, edge_consumer};
use crate::clock::now_ms;
use crate::names;

/// Key of the settings: [`FleetLimits`].
const LIMITS: &str = "limits";

const NO_JETSTREAM: &str =
    "the server does not answer for JetStream: is it started with -js, and may this user use it?";

/// Makes the consumer of an edge's results, which the edge's own key may not do (docs/fleet.md).
///
/// # Errors
/// [`JetStreamError`].
pub async fn init_edge(
    context: &Context,
    edge: &str,
    hobs: &[String],
) -> Result<(), JetStreamError> {
    let config = edge_consumer(edge, hobs);
    let made = context.create_consumer_on_stream(config, names::RESULTS);
    made.await.map(drop).map_err(failed(names::RESULTS))
}

/// Returns the limits of the last [`init`]; `None` on a server without a fleet.
///
/// # Errors
/// [`JetStreamError`] if they cannot be read.
pub async fn limits(context: &Context) -> Result<Option<FleetLimits>, JetStreamError> {
    let settings = match context.get_key_value(names::SETTINGS).await {
        Ok(settings) => settings,
        Err(e) if e.to_string().contains("not found") => return Ok(None),
        Err(e) if e.to_string().contains("timed out") => {
            return Err(JetStreamError::new(names::SETTINGS, NO_JETSTREAM));
        }
        Err(e) => return Err(JetStreamError::new(names::SETTINGS, e)),
    };
    let text = settings
        .get(LIMITS)
        .await
        .map_err(failed(names::SETTINGS))?;
    let read = |text: Bytes| {
        serde_json::from_slice(&text).map_err(|e| {
            let why = format!("its limits cannot be read, which a later ihd has set: {e}");
            JetStreamError::new(names::SETTINGS, why)
        })
    };
    text.map(read).transpose()
}

/// Returns a stream; `None` if there is none.
async fn existing(context: &Context, name: &str) -> Result<Option<stream::Stream>, JetStreamError> {
    match context.get_stream(name).await {
        Ok(stream) => Ok(Some(stream)),
        Err(e) => match e.kind() {
            GetStreamErrorKind::JetStream(e) if e.error_code() == ErrorCode::STREAM_NOT_FOUND => {
                Ok(None)
            }
            GetStreamErrorKind::Request => Err(JetStreamError::new(name, NO_JETSTREAM)),
            _ => Err(JetStreamError::new(name, e)),
        },
    }
}

/// Refuses a limit of a stream that would delete what it holds.
async fn refuse_deletion(context: &Context, config: &stream::Config) -> Result<(), JetStreamError> {
    let Some(there) = existing(context, &config.name).await? else {
        return Ok(());
    };
    let state = &there.cached_info().state;
    let most = u64::try_from(config.max_bytes).unwrap_or(u64::MAX);
    if state.messages > 0 && state.bytes > most {
        let why = format!(
            "it holds {} bytes, more than the {most} that it is to have: `init` deletes nothing",
            state.bytes
        );
        return Err(JetStreamError::new(&config.name, why));
    }
    let days = config.max_age.as_secs() / DAY.as_secs();
    let first_s = state.first_timestamp.unix_timestamp();
    let age_s = u64::try_from(now_ms() / 1_000 - first_s).unwrap_or(0);
    let becomes_shorter = there.cached_info().config.max_age > config.max_age;
    if state.messages > 0 && becomes_shorter && days > 0 && age_s > config.max_age.as_secs() {
        let why = format!(
            "its first message is {} days old, more than the {days} that it is to have: `init` deletes nothing",
            age_s / DAY.as_secs()
        );
        return Err(JetStreamError::new(&config.name, why));
    }
    Ok(())
}

/// Makes missing streams, buckets and consumers and applies the limits to existing ones. No data is deleted: a limit below what is there is
/// refused before anything is changed.
///
/// # Errors
/// [`JetStreamError`] with the name of the refused object.
pub async fn init(context: &Context, limits: &FleetLimits) -> Result<(), JetStreamError> {
    for config in &limits.streams() {
        refuse_deletion(context, config).await?;
    }
    let captures = existing(context, names::CAPTURES_STREAM).await?;
    let captures = captures.map(|captures| stream::Config {
        max_bytes: limits.captures_bytes,
        num_replicas: usize::from(limits.replicas),
        ..captures.cached_info().config.clone()
    });
    if let Some(config) = &captures {
        refuse_deletion(context, config).await?;
    }
    for config in limits.streams() {
        let name = config.name.clone();
        let made = context.create_or_update_stream(config).await;
        made.map_err(|e| match e.kind() {
            CreateStreamErrorKind::TimedOut => JetStreamError::new(&name, NO_JETSTREAM),
            _ => JetStreamError::new(&name, e),
        })?;
    }
    let windows = context.get_stream_no_info(names::WINDOWS).await;
    let windows = windows.map_err(failed(names::WINDOWS))?;
    // Its filter overlaps with the present one, and its workers would give up windows of a later version.
    let _ = windows.delete_consumer(names::WORKERS_1).await;
    let workers = windows.create_consumer(limits.workers()).await;
    workers.map_err(failed(names::WORKERS))?;
    for config in limits.buckets() {
        let name = config.name.clone();
        let made = context.create_or_update_stream(config).await;
        made.map_err(failed(&name))?;
    }
    match captures {
        Some(config) => {
            let made = context.update_stream(config).await;
            made.map(drop).map_err(failed(names::CAPTURES))?;
        }
        None => {
            let made = context.create_object_store(limits.captures()).await;
            made.map(drop).map_err(failed(names::CAPTURES))?;
        }
    }
    let settings = bucket(context, names::SETTINGS).await?;
    let text = serde_json::to_vec(limits).unwrap_or_default();
    let put = settings.put(LIMITS, text.into()).await;
    put.map_err(failed(names::SETTINGS))?;
    Ok(())
}
