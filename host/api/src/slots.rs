//! Slots for connections: a fixed number, some of them reserved for connections with an admitted request.
//!
//! ```text
//!             first byte            a request is admitted
//!   Silent ───────────────► Active ──────────────────────► Admitted
//!   └───── UNADMITTED_SLOTS ─────┘                         └ ADMITTED_SLOTS
//! ```
//!
//! Each accepted connection gets a slot. If all unadmitted slots are taken, one of their connections is evicted: the oldest silent one, else
//! the oldest active one. If all admitted slots are taken, one of their connections without a request in progress is evicted: the one whose
//! last request is the oldest. If each has a request in progress, a newly admitted connection is served in its unadmitted slot.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use ihd_daemon::locking::lock;
use tokio::sync::watch;

/// Slots of connections without an admitted request.
pub(crate) const UNADMITTED_SLOTS: usize = 48;

/// Slots of connections with an admitted request; more than event streams may take.
pub(crate) const ADMITTED_SLOTS: usize = 80;

/// Maximum number of simultaneous connections; one more evicts another.
pub const MAX_CONNECTIONS: usize = UNADMITTED_SLOTS + ADMITTED_SLOTS;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Silent,
    Active,
    Admitted,
}

struct Entry {
    phase: Phase,
    /// Requests in progress.
    requests: u32,
    /// Turn of the connection's acceptance or of its last admitted request.
    turn: u64,
    evicted: watch::Sender<bool>,
}

#[derive(Default)]
struct Table {
    turn: u64,
    entries: BTreeMap<u64, Entry>,
    evictions: u64,
}

impl Table {
    fn next_turn(&mut self) -> u64 {
        self.turn += 1;
        self.turn
    }

    fn count(&self, is_admitted: bool) -> usize {
        let counts = |e: &&Entry| (e.phase == Phase::Admitted) == is_admitted;
        self.entries.values().filter(counts).count()
    }

    /// Evicts the first connection, by phase and turn, for which `is_candidate` is `true`; returns `false` if there is none.
    fn evict(&mut self, is_candidate: impl Fn(&Entry) -> bool) -> bool {
        let candidates = self.entries.iter().filter(|(_, entry)| is_candidate(entry));
        let first = candidates.min_by_key(|(_, entry)| (entry.phase, entry.turn));
        let Some(id) = first.map(|(id, _)| *id) else {
            return false;
        };
        if let Some(entry) = self.entries.remove(&id) {
            entry.evicted.send_replace(true);
            self.evictions += 1;
        }
        true
    }
}

/// All slots of a server.
#[derive(Clone, Default)]
pub(crate) struct ConnectionSlots(Arc<Mutex<Table>>);

impl ConnectionSlots {
    fn lock(&self) -> MutexGuard<'_, Table> {
        lock(&self.0)
    }

    /// Returns a slot for a newly accepted connection; evicts another connection if no slot is free.
    pub(crate) fn assign(&self) -> Slot {
        let mut table = self.lock();
        if table.count(false) >= UNADMITTED_SLOTS {
            table.evict(|entry| entry.phase < Phase::Admitted);
        }
        let (sender, evicted) = watch::channel(false);
        let turn = table.next_turn();
        let entry = Entry {
            phase: Phase::Silent,
            requests: 0,
            turn,
            evicted: sender,
        };
        table.entries.insert(turn, entry);
        drop(table);
        Slot(Arc::new(SlotInner {
            slots: self.clone(),
            id: turn,
            evicted,
        }))
    }

    /// Returns the number of evicted connections since the start.
    pub(crate) fn evictions(&self) -> u64 {
        self.lock().evictions
    }
}

/// Slot of one connection, freed when its last clone is dropped.
#[derive(Clone)]
pub(crate) struct Slot(Arc<SlotInner>);

struct SlotInner {
    slots: ConnectionSlots,
    id: u64,
    evicted: watch::Receiver<bool>,
}

impl Drop for SlotInner {
    fn drop(&mut self) {
        self.slots.lock().entries.remove(&self.id);
    }
}

impl Slot {
    fn change(&self, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.0.slots.lock().entries.get_mut(&self.0.id) {
            change(entry);
        }
    }

    /// Records that the connection's first byte was received.
    pub(crate) fn first_byte_received(&self) {
        self.change(|entry| entry.phase = entry.phase.max(Phase::Active));
    }

    /// Records that a request of the connection was admitted; moves it to an admitted slot if one can be had.
    pub(crate) fn admit(&self) {
        let mut table = self.0.slots.lock();
        let turn = table.next_turn();
        let is_full = table.count(true) >= ADMITTED_SLOTS;
        let is_admitted = |e: &Entry| e.phase == Phase::Admitted;
        let entry = table.entries.get(&self.0.id);
        let needs_one = entry.is_some_and(|entry| !is_admitted(entry));
        if needs_one && is_full && !table.evict(|e| is_admitted(e) && e.requests == 0) {
            return;
        }
        if let Some(entry) = table.entries.get_mut(&self.0.id) {
            entry.phase = Phase::Admitted;
            entry.turn = turn;
        }
    }

    /// Returns `true` if the connection has an admitted slot.
    pub(crate) fn is_admitted(&self) -> bool {
        let table = self.0.slots.lock();
        let entry = table.entries.get(&self.0.id);
        entry.is_some_and(|entry| entry.phase == Phase::Admitted)
    }

    /// Counts a request as in progress until the returned guard is dropped.
    pub(crate) fn begin_request(&self) -> RequestGuard {
        self.change(|entry| entry.requests += 1);
        RequestGuard(self.clone())
    }

    /// Completes when the connection is evicted.
    pub(crate) async fn evicted(&self) {
        // The sender lives until the connection is evicted or its slot freed: the wait cannot fail before.
        let _ = self.0.evicted.clone().wait_for(|&now| now).await;
    }
}

/// Request in progress.
pub(crate) struct RequestGuard(Slot);

impl Drop for RequestGuard {
    fn drop(&mut self) {
        self.0
            .change(|entry| entry.requests = entry.requests.saturating_sub(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_there(slot: &Slot) -> bool {
        !*slot.0.evicted.borrow()
    }

    /// Takes all admitted slots.
    fn admit_all(slots: &ConnectionSlots) -> Vec<Slot> {
        let all: Vec<Slot> = (0..ADMITTED_SLOTS)
            .map(|_| {
                let slot = slots.assign();
                slot.admit();
                slot
            })
            .collect();
        assert!(all.iter().all(|slot| is_there(slot) && slot.is_admitted()));
        all
    }

    #[test]
    fn the_oldest_silent_connection_is_evicted_then_the_oldest_active_one() {
        let slots = ConnectionSlots::default();
        let active = slots.assign();
        active.first_byte_received();
        let mut others: Vec<Slot> = (1..UNADMITTED_SLOTS).map(|_| slots.assign()).collect();
        assert!(others.iter().all(is_there));
        for oldest in 0..100 {
            others.push(slots.assign());
            assert!(!is_there(&others[oldest]));
            assert!(is_there(&active) && others[oldest + 1..].iter().all(is_there));
        }
        for other in &others[100..] {
            other.first_byte_received();
        }
        let _next = slots.assign();
        assert!(!is_there(&active) && is_there(&others[100]));
        assert_eq!(slots.evictions(), 101);
    }

    #[test]
    fn no_number_of_unadmitted_connections_evicts_an_admitted_one() {
        let slots = ConnectionSlots::default();
        let admitted = admit_all(&slots);
        let others: Vec<Slot> = (0..1_000).map(|_| slots.assign()).collect();
        assert!(
            admitted
                .iter()
                .all(|slot| is_there(slot) && slot.is_admitted())
        );
        let left = others.iter().filter(|slot| is_there(slot)).count();
        assert_eq!(left, UNADMITTED_SLOTS);
        assert_eq!(slots.lock().entries.len(), MAX_CONNECTIONS);
        // A newly admitted connection evicts the one whose last request is the oldest.
        admitted[0].admit();
        let last = others.last().unwrap();
        last.admit();
        assert!(last.is_admitted() && is_there(&admitted[0]) && !is_there(&admitted[1]));
        drop((admitted, others));
        assert_eq!(slots.lock().entries.len(), 0);
    }

    #[test]
    fn a_connection_with_a_request_is_not_evicted_and_the_next_one_is_served() {
        let slots = ConnectionSlots::default();
        let admitted = admit_all(&slots);
        let mut requests: Vec<RequestGuard> = admitted.iter().map(Slot::begin_request).collect();
        let next = slots.assign();
        next.admit();
        assert!(is_there(&next) && !next.is_admitted());
        assert!(admitted.iter().all(is_there));
        drop(requests.swap_remove(7));
        next.admit();
        assert!(next.is_admitted() && !is_there(&admitted[7]));
    }
}
