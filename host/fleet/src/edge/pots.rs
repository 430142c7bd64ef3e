//! Pots that hobs know: each hob's go to the fleet under its key, those of all come back as what a new pot may be.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use ihd_map::library::{Library, LibraryError, MOST_OF_ONE_HOB, PotEntry, Provenance};

use super::{Link, TRY_AGAIN, now_ms};
use crate::engine::{self, EngineError};
use crate::names;

/// Between two looks. A pot that a hob meets is one of an hour ago, too.
const LOOK_EVERY: Duration = Duration::from_secs(60);

/// Gives and takes until the edge ends.
pub async fn run(link: Arc<Link>, context: Context) {
    loop {
        let pause = match link.is_admitted() {
            true => match exchange(&link, &context).await {
                Ok(()) => {
                    link.works("pots");
                    LOOK_EVERY
                }
                Err(why) => {
                    link.failed("pots", &why);
                    LOOK_EVERY
                }
            },
            false => TRY_AGAIN,
        };
        if !link.wait(pause).await {
            return;
        }
    }
}

async fn exchange(link: &Link, context: &Context) -> Result<(), EngineError> {
    let there = engine::entries(context, names::POTS).await?;
    let mut libraries: BTreeMap<String, Library> = BTreeMap::new();
    for (hob, bytes) in &there {
        match of_hob(hob, bytes) {
            Ok(library) => {
                libraries.insert(hob.clone(), library);
            }
            // Its edge sends them again, or it lies.
            Err(why) => tracing::debug!(hob, %why, "pots of a hob are not taken"),
        }
    }
    for hob in link.hobs() {
        let by = Provenance {
            hob: hob.clone(),
            build: env!("CARGO_PKG_VERSION").to_owned(),
            t_unix_s: u64::try_from(now_ms() / 1_000).unwrap_or(0),
        };
        let Some(entry) = link.daemon.pot_entry(&hob, by) else {
            continue;
        };
        let mine = libraries.entry(hob.clone()).or_default();
        if mine.add(entry).is_err() {
            continue;
        }
        let bytes = mine.to_bytes();
        if there.get(&hob).is_none_or(|known| *known != bytes) {
            engine::put(context, names::POTS, &hob, bytes).await?;
        }
    }
    let mut all = Library::default();
    for entry in libraries.values().flat_map(Library::entries) {
        // Each was looked at.
        let _ = all.add(entry.clone());
    }
    let pots = all.entries().len();
    if link.daemon.use_library(all) {
        tracing::info!(pots, "pots that hobs of the fleet know");
    }
    Ok(())
}

/// What a hob's key holds: entries that it has found itself, whatever they say of others.
fn of_hob(hob: &str, bytes: &[u8]) -> Result<Library, LibraryError> {
    let sent = Library::from_bytes(bytes)?;
    let own = |entry: &&PotEntry| entry.hobs().len() == 1 && entry.hobs()[0] == hob;
    let mut library = Library::default();
    for entry in sent.entries().iter().filter(own).take(MOST_OF_ONE_HOB) {
        library.add(entry.clone())?;
    }
    Ok(library)
}
