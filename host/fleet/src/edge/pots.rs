//! Pot library of the fleet: each hob's pots are put under its key, and those of all hobs are read as candidates for a new pot.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use ihd_map::library::{Library, LibraryError, MAX_OF_ONE_HOB, PotEntry, Provenance};
use tokio::time::Instant;

use super::link::Link;
use super::refusals::RETRY_PAUSE;
use crate::clock::now_ms;
use crate::jetstream::{self, JetStreamError};
use crate::names;

/// Part of which failures are recorded.
const PART: &str = "pots";

/// Period of the exchange; the library changes slowly.
const POLL_PERIOD: Duration = Duration::from_secs(60);

/// Exchanges pots until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    while link
        .turn(PART, POLL_PERIOD, take_turn(&link, &context))
        .await
    {}
}

/// Exchanges pots; returns the pause before the next exchange.
async fn take_turn(link: &Link, context: &Context) -> Result<Duration, JetStreamError> {
    if !link.is_admitted() {
        return Ok(RETRY_PAUSE);
    }
    exchange(link, context).await?;
    link.works(PART);
    Ok(POLL_PERIOD)
}

async fn exchange(link: &Link, context: &Context) -> Result<(), JetStreamError> {
    let began = Instant::now();
    let there = jetstream::entries(context, names::POTS).await?;
    let mut libraries: BTreeMap<String, Library> = BTreeMap::new();
    for (hob, entry) in &there {
        match own_entries(hob, &entry.value) {
            Ok(library) => {
                libraries.insert(hob.clone(), library);
            }
            // The hob's edge repairs them, or they are forged.
            Err(why) => tracing::debug!(hob, %why, "pots of a hob are not taken"),
        }
    }
    for hob in link.hobs() {
        let by = Provenance {
            hob: hob.clone(),
            build: env!("CARGO_PKG_VERSION").to_owned(),
            t_unix_s: u64::try_from(now_ms() / 1_000).unwrap_or(0),
        };
        let Some(entry) = link.daemon.fleet().pot_entry(&hob, by) else {
            continue;
        };
        let mine = libraries.entry(hob.clone()).or_default();
        if mine.add(entry).is_err() {
            continue;
        }
        let bytes = mine.to_bytes();
        if there.get(&hob).is_none_or(|known| known.value != bytes) {
            match jetstream::put(context, names::POTS, &hob, bytes).await {
                Ok(()) => link.accepted(PART, &hob),
                Err(why) => link.refused(PART, &hob, &why, began),
            }
        }
    }
    let mut all = Library::default();
    for entry in libraries.values().flat_map(Library::entries) {
        // Checked above.
        let _ = all.add(entry.clone());
    }
    let pots = all.entries().len();
    if link.daemon.fleet().use_library(all) {
        tracing::info!(pots, "pots that hobs of the fleet know");
    }
    Ok(())
}

/// Returns the entries under a hob's key that are of this hob alone.
fn own_entries(hob: &str, bytes: &[u8]) -> Result<Library, LibraryError> {
    let sent = Library::from_bytes(bytes)?;
    let own = |entry: &&PotEntry| entry.hobs().len() == 1 && entry.hobs()[0] == hob;
    let mut library = Library::default();
    for entry in sent.entries().iter().filter(own).take(MAX_OF_ONE_HOB) {
        library.add(entry.clone())?;
    }
    Ok(library)
}
