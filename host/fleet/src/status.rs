//! Report of the whole fleet.

use std::collections::BTreeMap;

use async_nats::jetstream::Context;
use ihd_model::{FleetDevice, FleetEdge, FleetReport, FleetWorker};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::clock::now_ms;
use crate::jetstream::{self, BucketEntry, JetStreamError};
use crate::names;

/// Card of a hob, published by its edge: the value of its key (JSON).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HobCard {
    /// Board, as reported by the firmware.
    #[serde(default)]
    pub board: String,
    /// Displayed data of the hob.
    pub device: FleetDevice,
}

/// Reads the present state of the fleet from the server.
///
/// # Errors
/// [`JetStreamError`] if the server does not answer, this key may not read, or the fleet was not initialised.
pub async fn report(context: &Context, server: &str) -> Result<FleetReport, JetStreamError> {
    let count = async |name| {
        let stream = jetstream::stream(context, name).await?;
        let state = &stream.cached_info().state;
        Ok::<_, JetStreamError>((state.messages, state.last_sequence))
    };
    let (backlog, windows) = count(names::WINDOWS).await?;
    let (_, results) = count(names::RESULTS).await?;
    let (dead, _) = count(names::DEAD).await?;
    // Times of the server in place of the senders': their clocks may be wrong.
    let workers = cards(context, names::WORKER_CARDS, |card: FleetWorker, at_ms| {
        FleetWorker {
            last_seen_ms: at_ms,
            ..card
        }
    });
    let workers = workers.await?;
    let edges = cards(context, names::EDGES, |card: FleetEdge, at_ms| FleetEdge {
        last_seen_ms: at_ms,
        ..card
    });
    let edges = edges.await?;
    let hobs = cards(context, names::HOBS, |mut card: HobCard, at_ms| {
        card.device.last_seen_ms = at_ms;
        card
    });
    let hobs = hobs.await?;
    let expected_build = jetstream::entries(context, names::SETTINGS).await?;
    let expected_build = expected_build.get(names::BUILD);
    let expected_build =
        expected_build.map(|build| String::from_utf8_lossy(&build.value).into_owned());
    Ok(FleetReport {
        server: server.to_owned(),
        connected: true,
        at_ms: now_ms(),
        windows,
        results,
        backlog,
        dead,
        workers: workers.into_values().collect(),
        // The key, not the card: that of a refused edge has its own.
        edges: edges
            .into_iter()
            .map(|(name, edge)| FleetEdge { name, ..edge })
            .collect(),
        devices: outdated(hobs, expected_build.as_deref()),
        ..FleetReport::default()
    })
}

/// Returns the hobs whose cards are of an edge.
///
/// # Errors
/// [`JetStreamError`].
pub(crate) async fn hobs_of(context: &Context, edge: &str) -> Result<Vec<String>, JetStreamError> {
    let hobs = cards(context, names::HOBS, |card: HobCard, _| card).await?;
    let of_edge = hobs
        .into_iter()
        .filter(|(_, card)| card.device.edge == edge);
    Ok(of_edge.map(|(hob, _)| hob).collect())
}

/// Returns the cards of a bucket without the unreadable ones, each after `dated` with the time of its arrival by this machine's clock.
async fn cards<T: DeserializeOwned>(
    context: &Context,
    bucket: &str,
    dated: impl Fn(T, i64) -> T,
) -> Result<BTreeMap<String, T>, JetStreamError> {
    let entries = jetstream::entries(context, bucket).await?;
    let now_ms = now_ms();
    let read = |(key, entry): (String, BucketEntry)| {
        let card = serde_json::from_slice(&entry.value);
        card.map_err(|why| tracing::debug!(bucket, key, %why, "a card cannot be read"))
            .ok()
            .map(|card| (key, dated(card, now_ms - entry.age_ms)))
    };
    Ok(entries.into_iter().filter_map(read).collect())
}

/// Marks hobs as outdated whose build differs from the expected one or, if that is `None`, from the most frequent one of their board.
pub fn outdated(hobs: BTreeMap<String, HobCard>, expected_build: Option<&str>) -> Vec<FleetDevice> {
    let mut counts: BTreeMap<(String, String), usize> = BTreeMap::new();
    for card in hobs.values().filter(|card| !card.device.build.is_empty()) {
        let of = (card.board.clone(), card.device.build.clone());
        *counts.entry(of).or_default() += 1;
    }
    let usual = |board: &str| {
        let of_board = counts.iter().filter(|((b, _), _)| b == board);
        // Of two equally frequent builds the later by name, which is the later version.
        let most = of_board.max_by_key(|((_, build), count)| (**count, build.clone()));
        most.map(|((_, build), _)| build.clone())
    };
    let device = |(name, card): (String, HobCard)| {
        let build = expected_build
            .map(str::to_owned)
            .or_else(|| usual(&card.board));
        let known = !card.device.build.is_empty();
        FleetDevice {
            // The key, not the card: only the hob's edge may write it.
            name,
            outdated: known && build.is_some_and(|build| build != card.device.build),
            ..card.device
        }
    };
    hobs.into_iter().map(device).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn card(board: &str, build: &str) -> HobCard {
        HobCard {
            board: board.into(),
            device: FleetDevice {
                build: build.into(),
                ..FleetDevice::default()
            },
        }
    }

    fn outdated_flags(cards: &[(&str, &str)], expected_build: Option<&str>) -> Vec<bool> {
        let hobs = cards.iter().enumerate();
        let hobs = hobs.map(|(k, (board, build))| (format!("hob-{k}"), card(board, build)));
        let devices = outdated(hobs.collect(), expected_build);
        devices.iter().map(|device| device.outdated).collect()
    }

    #[test]
    fn who_differs_from_most_of_its_board_is_outdated() {
        let cards = [
            ("a", "1.1"),
            ("a", "1.0"),
            ("a", "1.1"),
            ("b", "1.0"),
            ("a", ""),
        ];
        assert_eq!(
            outdated_flags(&cards, None),
            [false, true, false, false, false]
        );
        assert_eq!(
            outdated_flags(&cards, Some("1.0")),
            [true, false, true, false, false]
        );
    }
}
