//! Places for connections: few, and never all taken by those who show nothing.
//!
//! ```text
//!             first byte             a request that is let in
//!   silent ───────────────► speaking ─────────────────────────► known
//!   └────── STRANGERS ──────────────┘                           └ KNOWN: the reserve
//! ```
//!
//! Each new connection gets a place. Where all of the strangers' are taken, one of them gives way: the oldest of the silent, else the oldest
//! that speaks. Where all of the reserve's are taken, one without a request under way gives way, the one that asked longest ago; where
//! each has one, whoever is let in is served on its stranger's place.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

/// Places of connections that were not let in yet.
pub(crate) const STRANGERS: usize = 48;

/// Places of connections that were: more than those who watch may take.
pub(crate) const KNOWN: usize = 80;

/// Connections at a time; one that comes above takes the place of another.
pub const MAX_CONNECTIONS: usize = STRANGERS + KNOWN;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Standing {
    Silent,
    Speaking,
    Known,
}

struct Entry {
    standing: Standing,
    /// Requests under way.
    requests: u32,
    /// Turn in which it came, or was let in, or asked last.
    turn: u64,
    given_up: watch::Sender<bool>,
}

#[derive(Default)]
struct Table {
    turn: u64,
    entries: BTreeMap<u64, Entry>,
    given_way: u64,
}

impl Table {
    fn next_turn(&mut self) -> u64 {
        self.turn += 1;
        self.turn
    }

    fn count(&self, is_known: bool) -> usize {
        let of = |e: &&Entry| (e.standing == Standing::Known) == is_known;
        self.entries.values().filter(of).count()
    }

    /// Takes the place of the first in this order of those that fit.
    fn give_up(&mut self, fits: impl Fn(&Entry) -> bool) -> bool {
        let fitting = self.entries.iter().filter(|(_, entry)| fits(entry));
        let first = fitting.min_by_key(|(_, entry)| (entry.standing, entry.turn));
        let Some(id) = first.map(|(id, _)| *id) else {
            return false;
        };
        if let Some(entry) = self.entries.remove(&id) {
            entry.given_up.send_replace(true);
            self.given_way += 1;
        }
        true
    }
}

/// All places.
#[derive(Clone, Default)]
pub(crate) struct Places(Arc<Mutex<Table>>);

impl Places {
    fn lock(&self) -> MutexGuard<'_, Table> {
        // Every change is complete in itself.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a connection that was accepted just now; another may have to give way.
    pub(crate) fn take(&self) -> Place {
        let mut table = self.lock();
        if table.count(false) >= STRANGERS {
            table.give_up(|entry| entry.standing < Standing::Known);
        }
        let (given_up, gives_way) = watch::channel(false);
        let turn = table.next_turn();
        let entry = Entry {
            standing: Standing::Silent,
            requests: 0,
            turn,
            given_up,
        };
        table.entries.insert(turn, entry);
        drop(table);
        Place(Arc::new(Seat {
            places: self.clone(),
            id: turn,
            gives_way,
        }))
    }

    /// Connections that gave way so far.
    pub(crate) fn given_way(&self) -> u64 {
        self.lock().given_way
    }
}

/// The place of one connection, free again when the last of its clones is dropped.
#[derive(Clone)]
pub(crate) struct Place(Arc<Seat>);

struct Seat {
    places: Places,
    id: u64,
    gives_way: watch::Receiver<bool>,
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.places.lock().entries.remove(&self.id);
    }
}

impl Place {
    fn change(&self, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.0.places.lock().entries.get_mut(&self.0.id) {
            change(entry);
        }
    }

    /// Its first byte has come.
    pub(crate) fn speaks(&self) {
        self.change(|entry| entry.standing = entry.standing.max(Standing::Speaking));
    }

    /// A request of it was let in: it gets one of the reserve's places, where there is one.
    pub(crate) fn is_let_in(&self) {
        let mut table = self.0.places.lock();
        let turn = table.next_turn();
        let is_full = table.count(true) >= KNOWN;
        let is_known = |e: &Entry| e.standing == Standing::Known;
        let entry = table.entries.get(&self.0.id);
        let needs_one = entry.is_some_and(|entry| !is_known(entry));
        if needs_one && is_full && !table.give_up(|e| is_known(e) && e.requests == 0) {
            return;
        }
        if let Some(entry) = table.entries.get_mut(&self.0.id) {
            entry.standing = Standing::Known;
            entry.turn = turn;
        }
    }

    /// Returns `true` if one of its requests was let in.
    pub(crate) fn is_known(&self) -> bool {
        let table = self.0.places.lock();
        let entry = table.entries.get(&self.0.id);
        entry.is_some_and(|entry| entry.standing == Standing::Known)
    }

    /// A request begins, which ends when the guard is dropped.
    pub(crate) fn request(&self) -> Request {
        self.change(|entry| entry.requests += 1);
        Request(self.clone())
    }

    /// Ready when it has to give way to another.
    pub(crate) async fn gives_way(&self) {
        // The sender lives as long as the place, or has told.
        let _ = self.0.gives_way.clone().wait_for(|&now| now).await;
    }
}

/// A request under way.
pub(crate) struct Request(Place);

impl Drop for Request {
    fn drop(&mut self) {
        self.0
            .change(|entry| entry.requests = entry.requests.saturating_sub(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_there(place: &Place) -> bool {
        !*place.0.gives_way.borrow()
    }

    /// Fills the reserve.
    fn let_in(places: &Places) -> Vec<Place> {
        let all: Vec<Place> = (0..KNOWN)
            .map(|_| {
                let place = places.take();
                place.is_let_in();
                place
            })
            .collect();
        assert!(all.iter().all(|place| is_there(place) && place.is_known()));
        all
    }

    #[test]
    fn the_oldest_that_says_nothing_gives_way_then_the_oldest_that_speaks() {
        let places = Places::default();
        let speaking = places.take();
        speaking.speaks();
        let mut strangers: Vec<Place> = (1..STRANGERS).map(|_| places.take()).collect();
        assert!(strangers.iter().all(is_there));
        for oldest in 0..100 {
            strangers.push(places.take());
            assert!(!is_there(&strangers[oldest]));
            assert!(is_there(&speaking) && strangers[oldest + 1..].iter().all(is_there));
        }
        for stranger in &strangers[100..] {
            stranger.speaks();
        }
        let _next = places.take();
        assert!(!is_there(&speaking) && is_there(&strangers[100]));
        assert_eq!(places.given_way(), 101);
    }

    #[test]
    fn no_number_of_strangers_takes_the_place_of_one_that_was_let_in() {
        let places = Places::default();
        let known = let_in(&places);
        let strangers: Vec<Place> = (0..1_000).map(|_| places.take()).collect();
        assert!(
            known
                .iter()
                .all(|place| is_there(place) && place.is_known())
        );
        assert_eq!(strangers.iter().filter(|s| is_there(s)).count(), STRANGERS);
        assert_eq!(places.lock().entries.len(), MAX_CONNECTIONS);
        // One that is let in takes the place of the one that asked longest ago.
        known[0].is_let_in();
        let last = strangers.last().unwrap();
        last.is_let_in();
        assert!(last.is_known() && is_there(&known[0]) && !is_there(&known[1]));
        drop((known, strangers));
        assert_eq!(places.lock().entries.len(), 0);
    }

    #[test]
    fn a_request_under_way_keeps_its_place_and_the_next_is_served_all_the_same() {
        let places = Places::default();
        let known = let_in(&places);
        let mut requests: Vec<Request> = known.iter().map(Place::request).collect();
        let next = places.take();
        next.is_let_in();
        assert!(is_there(&next) && !next.is_known());
        assert!(known.iter().all(is_there));
        drop(requests.swap_remove(7));
        next.is_let_in();
        assert!(next.is_known() && !is_there(&known[7]));
    }
}
