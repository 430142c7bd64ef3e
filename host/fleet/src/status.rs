//! The whole fleet in numbers.

use std::collections::BTreeMap;

use async_nats::jetstream::Context;
use ihd_daemon::model::{FleetDevice, FleetEdge, FleetReport, FleetWorker};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::edge::now_ms;
use crate::engine::{self, EngineError};
use crate::names;

/// What an edge tells of a hob: the value of its key (JSON).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HobCard {
    /// The board, as its firmware says.
    #[serde(default)]
    pub board: String,
    /// What is shown of it.
    pub device: FleetDevice,
}

/// The fleet as the server has it now.
///
/// # Errors
/// [`EngineError`]: the server does not answer, this key may not look, or the fleet was never made.
pub async fn report(context: &Context, server: &str) -> Result<FleetReport, EngineError> {
    let count = async |name| {
        let stream = engine::stream(context, name).await?;
        let state = &stream.cached_info().state;
        Ok::<_, EngineError>((state.messages, state.last_sequence))
    };
    let (backlog, windows) = count(names::WINDOWS).await?;
    let (_, results) = count(names::RESULTS).await?;
    let (dead, _) = count(names::DEAD).await?;
    let workers: BTreeMap<String, FleetWorker> = cards(context, names::WORKER_CARDS).await?;
    let edges: BTreeMap<String, FleetEdge> = cards(context, names::EDGES).await?;
    let hobs: BTreeMap<String, HobCard> = cards(context, names::HOBS).await?;
    let wanted = engine::entries(context, names::SETTINGS).await?;
    let wanted = wanted.get(names::BUILD);
    let wanted = wanted.map(|build| String::from_utf8_lossy(build).into_owned());
    Ok(FleetReport {
        server: server.to_owned(),
        connected: true,
        at_ms: now_ms(),
        windows,
        results,
        backlog,
        dead,
        workers: workers.into_values().collect(),
        edges: edges.into_values().collect(),
        devices: outdated(hobs, wanted.as_deref()),
        ..FleetReport::default()
    })
}

/// What a bucket holds; what cannot be read is left out.
async fn cards<T: DeserializeOwned>(
    context: &Context,
    bucket: &str,
) -> Result<BTreeMap<String, T>, EngineError> {
    let entries = engine::entries(context, bucket).await?;
    let read = |(key, value): (String, bytes::Bytes)| {
        let card = serde_json::from_slice(&value);
        card.map_err(|why| tracing::debug!(bucket, key, %why, "a card cannot be read"))
            .ok()
            .map(|card| (key, card))
    };
    Ok(entries.into_iter().filter_map(read).collect())
}

/// Marks who has another build than is wanted, or, where nobody says, than most hobs of its board.
pub fn outdated(hobs: BTreeMap<String, HobCard>, wanted: Option<&str>) -> Vec<FleetDevice> {
    let mut counts: BTreeMap<(String, String), usize> = BTreeMap::new();
    for card in hobs.values().filter(|card| !card.device.build.is_empty()) {
        let of = (card.board.clone(), card.device.build.clone());
        *counts.entry(of).or_default() += 1;
    }
    let usual = |board: &str| {
        let of_board = counts.iter().filter(|((b, _), _)| b == board);
        // Of two that are as frequent the later by name, which is the later version.
        let most = of_board.max_by_key(|((_, build), count)| (**count, build.clone()));
        most.map(|((_, build), _)| build.clone())
    };
    let device = |(name, card): (String, HobCard)| {
        let build = wanted.map(str::to_owned).or_else(|| usual(&card.board));
        let known = !card.device.build.is_empty();
        FleetDevice {
            // Whoever may write the key is who it says.
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

    fn of(cards: &[(&str, &str)], wanted: Option<&str>) -> Vec<bool> {
        let hobs = cards.iter().enumerate();
        let hobs = hobs.map(|(k, (board, build))| (format!("hob-{k}"), card(board, build)));
        let devices = outdated(hobs.collect(), wanted);
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
        assert_eq!(of(&cards, None), [false, true, false, false, false]);
        assert_eq!(of(&cards, Some("1.0")), [true, false, true, false, false]);
    }
}
