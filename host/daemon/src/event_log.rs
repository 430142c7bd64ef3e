//! Log of the daemon's events in the store, written in batches.
//!
//! Faults and forced switch-offs are stored where they happen. All other events are stored here, so that no task waits for it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_model::{DaemonEvent, EventKind, RecordKind};
use ihd_store::NewEvent;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::TryRecvError;

use crate::context::Context;
use crate::store_thread::StoreThread;

/// Period of writing.
const WRITE_PERIOD: Duration = Duration::from_millis(500);

/// Largest number of events that wait for the store.
const CAPACITY: usize = 2_000;

/// Largest number of events per period; beyond it a device floods the log.
const MAX_PER_PERIOD: usize = 100;

/// Stores events until the daemon stops.
pub async fn run(context: Context, mut events: broadcast::Receiver<Arc<DaemonEvent>>) {
    let daemon_event = |text| daemon_event(text, context.machine.now_ms());
    let mut waiting = VecDeque::from([daemon_event("started")]);
    loop {
        let stopping = tokio::select! {
            biased;
            () = context.stopping() => true,
            () = tokio::time::sleep(WRITE_PERIOD) => false,
        };
        let no_room = collect(&mut events, &mut waiting, context.machine.now_ms());
        context.store.count_dropped(RecordKind::Events, no_room);
        if stopping {
            waiting.push_back(daemon_event("stopped"));
        }
        write(&context.store, &mut waiting).await;
        if stopping {
            return;
        }
    }
}

/// Returns an event of the daemon itself.
fn daemon_event(text: &str, at_ms: i64) -> NewEvent {
    NewEvent {
        at_ms,
        device: String::new(),
        kind: "daemon",
        text: text.to_owned(),
    }
}

/// Appends received events to `waiting`. Returns the number dropped because the store has accepted none for too long.
fn collect(
    events: &mut broadcast::Receiver<Arc<DaemonEvent>>,
    waiting: &mut VecDeque<NewEvent>,
    at_ms: i64,
) -> u64 {
    let (mut accepted, mut dropped, mut no_room) = (0, 0, 0);
    loop {
        let entry = match events.try_recv() {
            Ok(event) => log_entry(&event),
            Err(TryRecvError::Lagged(missed)) => {
                dropped += missed;
                continue;
            }
            Err(TryRecvError::Empty | TryRecvError::Closed) => break,
        };
        let Some(entry) = entry else { continue };
        if waiting.len() >= CAPACITY {
            dropped += 1;
            no_room += 1;
        } else if accepted == MAX_PER_PERIOD {
            dropped += 1;
        } else {
            accepted += 1;
            waiting.push_back(entry);
        }
    }
    if dropped > 0 {
        tracing::warn!(dropped, "more events than the log accepts");
        if waiting.len() > CAPACITY {
            return no_room;
        }
        waiting.push_back(NewEvent {
            at_ms,
            device: String::new(),
            kind: "missed",
            text: format!("{dropped} events were not logged"),
        });
    }
    no_room
}

async fn write(store: &StoreThread, waiting: &mut VecDeque<NewEvent>) {
    if waiting.is_empty() {
        return;
    }
    let events: Vec<_> = waiting.iter().cloned().collect();
    let store = store.writing(RecordKind::Events);
    let stored = store.run(move |store| store.keep_events(&events)).await;
    // After an error the events wait for the next period; the store's thread reports the error.
    if stored.is_ok() {
        waiting.clear();
    }
}

/// Returns the log entry of an event; `None` if the event is stored elsewhere.
fn log_entry(event: &DaemonEvent) -> Option<NewEvent> {
    let (kind, text) = match &event.kind {
        EventKind::State { state, detail } if detail.is_empty() => {
            ("state", state.as_str().to_owned())
        }
        EventKind::State { state, detail } => ("state", format!("{}: {detail}", state.as_str())),
        EventKind::Pot { text, .. } | EventKind::PotTemperature { text, .. } => {
            ("pot", text.clone())
        }
        EventKind::LookupActive {
            version,
            observed_cells,
        } => (
            "lookup",
            format!("version {version} is active, {observed_cells} cells known"),
        ),
        EventKind::LookupRefused { version, why } => {
            ("lookup", format!("version {version} was refused: {why}"))
        }
        EventKind::Lease { holder, why, .. } if holder.is_empty() => {
            let why = if why.is_empty() {
                ""
            } else {
                &format!(": {why}")
            };
            ("lease", format!("nobody commands it{why}"))
        }
        EventKind::Lease {
            holder, taken_from, ..
        } if taken_from.is_empty() => ("lease", format!("{holder} commands it")),
        EventKind::Lease {
            holder, taken_from, ..
        } => (
            "lease",
            format!("{holder} commands it, taken from {taken_from}"),
        ),
        EventKind::WindowRefused { seq, why } => ("window", format!("window {seq} refused: {why}")),
        EventKind::Recording {
            text,
            file: Some(file),
            ..
        } => ("recording", format!("{file}: {text}")),
        EventKind::Recording { text, .. } => ("recording", text.clone()),
        EventKind::Store { text, .. } => ("store", text.clone()),
        EventKind::Telemetry { .. }
        | EventKind::WindowStored { .. }
        | EventKind::ResultStored { .. }
        | EventKind::Fault { .. }
        | EventKind::Command { .. } => return None,
    };
    Some(NewEvent {
        at_ms: event.at_ms,
        device: event.device.clone(),
        kind,
        text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event_bus::EventBus;
    use ihd_model::DeviceState;

    #[test]
    fn what_a_device_that_plays_does_is_bounded_and_counted() {
        let event_bus = EventBus::default();
        let mut events = event_bus.subscribe();
        let mut waiting = VecDeque::new();
        for k in 0..100_000 {
            event_bus.publish(
                "a",
                EventKind::WindowRefused {
                    seq: k,
                    why: "a test".into(),
                },
            );
        }
        assert_eq!(
            collect(&mut events, &mut waiting, 0),
            0,
            "the store would have room"
        );
        assert_eq!(waiting.len(), MAX_PER_PERIOD + 1);
        let last = waiting.back().unwrap();
        assert_eq!(
            (last.kind, last.text.as_str()),
            ("missed", "99900 events were not logged")
        );
        // A store that accepts nothing.
        for _ in 0..100 {
            for seq in 0..200 {
                event_bus.publish(
                    "a",
                    EventKind::WindowRefused {
                        seq,
                        why: String::new(),
                    },
                );
            }
            collect(&mut events, &mut waiting, 0);
        }
        assert!(waiting.len() <= CAPACITY + 100, "{}", waiting.len());
        event_bus.publish(
            "a",
            EventKind::WindowRefused {
                seq: 0,
                why: String::new(),
            },
        );
        assert_eq!(
            collect(&mut events, &mut waiting, 0),
            1,
            "the store has no room for it"
        );
        event_bus.publish(
            "a",
            EventKind::State {
                state: DeviceState::Idle,
                detail: String::new(),
            },
        );
        let mut fresh = VecDeque::new();
        collect(&mut events, &mut fresh, 0);
        assert_eq!(
            (
                fresh[0].kind,
                fresh[0].text.as_str(),
                fresh[0].device.as_str()
            ),
            ("state", "idle", "a")
        );
    }
}
