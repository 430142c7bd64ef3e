//! What happens to devices, into the store's events: notices, some at a time.
//!
//! Faults, and what ends heating, are stored where they happen; the rest comes through here, so that nobody waits for
//! it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_store::NewEvent;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::TryRecvError;

use crate::device::Context;
use crate::model::{Notice, Record, What};
use crate::store_thread::StoreThread;

/// Between two looks at what happened.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// Events that may wait for the store.
const WAITING: usize = 2_000;

/// Events of one look: what is beyond that is a device that plays.
const A_LOOK: usize = 100;

/// Takes notices down until the daemon stops.
pub async fn take_down(context: Context, mut notices: broadcast::Receiver<Arc<Notice>>) {
    let of_daemon = |text| of_daemon(text, context.machine.now_ms());
    let mut waiting = VecDeque::from([of_daemon("started")]);
    loop {
        let stopping = tokio::select! {
            biased;
            () = context.stopping() => true,
            () = tokio::time::sleep(LOOK_EVERY) => false,
        };
        let no_room = collect(&mut notices, &mut waiting, context.machine.now_ms());
        context.store.dropped(Record::Events, no_room);
        if stopping {
            waiting.push_back(of_daemon("stopped"));
        }
        write(&context.store, &mut waiting).await;
        if stopping {
            return;
        }
    }
}

/// What the daemon says of itself.
fn of_daemon(text: &str, at_ms: i64) -> NewEvent {
    NewEvent {
        at_ms,
        device: String::new(),
        kind: "daemon",
        text: text.to_owned(),
    }
}

/// Appends what happened; returns how many events found no room because the store takes none.
fn collect(
    notices: &mut broadcast::Receiver<Arc<Notice>>,
    waiting: &mut VecDeque<NewEvent>,
    at_ms: i64,
) -> u64 {
    let (mut taken, mut beyond, mut no_room) = (0, 0, 0);
    loop {
        let event = match notices.try_recv() {
            Ok(notice) => event(&notice),
            Err(TryRecvError::Lagged(missed)) => {
                beyond += missed;
                continue;
            }
            Err(TryRecvError::Empty | TryRecvError::Closed) => break,
        };
        let Some(event) = event else { continue };
        if waiting.len() >= WAITING {
            beyond += 1;
            no_room += 1;
        } else if taken == A_LOOK {
            beyond += 1;
        } else {
            taken += 1;
            waiting.push_back(event);
        }
    }
    if beyond > 0 {
        tracing::warn!(beyond, "more happened than the journal takes down");
        if waiting.len() > WAITING {
            return no_room;
        }
        waiting.push_back(NewEvent {
            at_ms,
            device: String::new(),
            kind: "missed",
            text: format!("{beyond} notices were not taken down"),
        });
    }
    no_room
}

async fn write(store: &StoreThread, waiting: &mut VecDeque<NewEvent>) {
    if waiting.is_empty() {
        return;
    }
    let events: Vec<_> = waiting.iter().cloned().collect();
    let store = store.writing(Record::Events);
    let stored = store.run(move |store| store.keep_events(&events)).await;
    // What the store does not take waits on; its trouble is told by its thread.
    if stored.is_ok() {
        waiting.clear();
    }
}

/// What is worth an event; the others are rows of their own.
fn event(notice: &Notice) -> Option<NewEvent> {
    let (kind, text) = match &notice.what {
        What::State { state, detail } if detail.is_empty() => ("state", state.word().to_owned()),
        What::State { state, detail } => ("state", format!("{}: {detail}", state.word())),
        What::Pot { text, .. } | What::PotTemperature { text, .. } => ("pot", text.clone()),
        What::LookupActive {
            version,
            observed_cells,
        } => (
            "lookup",
            format!("version {version} is active, {observed_cells} cells known"),
        ),
        What::LookupRefused { version, why } => {
            ("lookup", format!("version {version} was refused: {why}"))
        }
        What::Lease { holder, why, .. } if holder.is_empty() => {
            let why = if why.is_empty() {
                ""
            } else {
                &format!(": {why}")
            };
            ("lease", format!("nobody commands it{why}"))
        }
        What::Lease {
            holder, taken_from, ..
        } if taken_from.is_empty() => ("lease", format!("{holder} commands it")),
        What::Lease {
            holder, taken_from, ..
        } => (
            "lease",
            format!("{holder} commands it, taken from {taken_from}"),
        ),
        What::WindowRefused { seq, why } => ("window", format!("window {seq} refused: {why}")),
        What::Recording {
            text,
            file: Some(file),
            ..
        } => ("recording", format!("{file}: {text}")),
        What::Recording { text, .. } => ("recording", text.clone()),
        What::Store { text, .. } => ("store", text.clone()),
        What::Telemetry { .. }
        | What::WindowStored { .. }
        | What::ResultStored { .. }
        | What::Fault { .. }
        | What::Command { .. } => return None,
    };
    Some(NewEvent {
        at_ms: notice.at_ms,
        device: notice.device.clone(),
        kind,
        text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Board;
    use crate::model::DeviceState;

    #[test]
    fn what_a_device_that_plays_does_is_bounded_and_counted() {
        let board = Board::default();
        let mut notices = board.watch();
        let mut waiting = VecDeque::new();
        for k in 0..100_000 {
            board.tell(
                "a",
                What::WindowRefused {
                    seq: k,
                    why: "a test".into(),
                },
            );
        }
        assert_eq!(
            collect(&mut notices, &mut waiting, 0),
            0,
            "the store would have room"
        );
        assert_eq!(waiting.len(), A_LOOK + 1);
        let last = waiting.back().unwrap();
        assert_eq!(
            (last.kind, last.text.as_str()),
            ("missed", "99900 notices were not taken down")
        );
        // A store that takes nothing.
        for _ in 0..100 {
            for seq in 0..200 {
                board.tell(
                    "a",
                    What::WindowRefused {
                        seq,
                        why: String::new(),
                    },
                );
            }
            collect(&mut notices, &mut waiting, 0);
        }
        assert!(waiting.len() <= WAITING + 100, "{}", waiting.len());
        board.tell(
            "a",
            What::WindowRefused {
                seq: 0,
                why: String::new(),
            },
        );
        assert_eq!(
            collect(&mut notices, &mut waiting, 0),
            1,
            "the store has no room for it"
        );
        board.tell(
            "a",
            What::State {
                state: DeviceState::Idle,
                detail: String::new(),
            },
        );
        let mut fresh = VecDeque::new();
        collect(&mut notices, &mut fresh, 0);
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
