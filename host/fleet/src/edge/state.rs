//! State of an edge.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use async_nats::Event;
use tokio::time::Instant;

use super::faults::Faults;
use super::oddities::Oddities;
use super::refusals::Refusals;
use super::trust::{Answers, Signs};
use crate::standing::Standing;

/// State of an edge: connection, right to its name, failures, answers.
#[derive(Default)]
pub(crate) struct State {
    pub connected: bool,
    /// Reason for which the server does not answer; empty if it does.
    pub away: String,
    /// Right of this edge to its name.
    pub standing: Standing,
    pub faults: Faults,
    /// Hobs of which the server refuses something.
    pub refusals: Refusals,
    pub oddities: Oddities,
    /// Number of ends of each part that ended before the edge.
    pub ended: BTreeMap<&'static str, u32>,
    pub answers: Answers,
    pub signs: Signs,
}

impl State {
    /// Creates the state of an edge without a connection.
    pub fn begin() -> Arc<Mutex<Self>> {
        Arc::new(Mutex::new(Self {
            away: "the server has not answered yet".to_owned(),
            ..Self::default()
        }))
    }

    /// Records that the server answers.
    pub fn connect(&mut self) {
        self.connected = true;
        self.away.clear();
        self.refusals.try_again(Instant::now());
        tracing::info!("the fleet's server answers");
    }

    /// Records that the server does not answer any more.
    pub fn disconnect(&mut self) {
        if self.connected {
            tracing::warn!("the fleet's server is away: this daemon goes on by itself");
        }
        self.connected = false;
        self.away = "the server does not answer".to_owned();
    }

    /// Applies an event of the connection.
    pub fn apply(&mut self, event: &Event) {
        match event {
            Event::Connected => self.connect(),
            Event::Disconnected | Event::LameDuckMode | Event::Draining | Event::Closed => {
                self.disconnect();
            }
            Event::ClientError(error) => self.away = error.to_string(),
            Event::ServerError(error) => self.away = error.to_string(),
            Event::SlowConsumer(_) => {}
        }
    }
}
