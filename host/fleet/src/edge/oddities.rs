//! Answers that this edge did not ask for: signs of another daemon with its store, or of a worker's key that is misused.

use std::collections::BTreeSet;
use std::time::Duration;

use tokio::time::Instant;

use super::trust::WindowKey;

/// Most remembered windows that were answered before they were sent.
const MAX_EARLY: usize = 65_536;

/// Time after which an alarm ends unless another such answer comes.
const ALARM_FOR: Duration = Duration::from_secs(3_600);

/// Answers that this edge did not ask for.
#[derive(Debug, Default)]
pub struct Oddities {
    /// Windows whose place in the results is taken: no worker's answer to them arrives.
    early: BTreeSet<WindowKey>,
    foreign: Count,
    unrequested: Count,
}

#[derive(Debug, Default)]
struct Count {
    answers: u64,
    last: Option<(Instant, String)>,
}

impl Count {
    fn add(&mut self, text: String) {
        self.answers += 1;
        self.last = Some((Instant::now(), text));
    }

    fn alarm(&self, now: Instant, what: &str) -> Option<String> {
        let (at, last) = self.last.as_ref()?;
        let is_present = now.duration_since(*at) < ALARM_FOR;
        is_present.then(|| format!("{} answers {what}; the last, {last}", self.answers))
    }
}

impl Oddities {
    /// Records an answer for a boot that the store does not know; returns `true` if it is the first.
    pub fn foreign(&mut self, (hob, boot, seq): &WindowKey) -> bool {
        self.foreign.add(format!("to {hob} {boot} {seq}"));
        self.foreign.answers == 1
    }

    /// Records an answer to a window that was never sent; returns `true` if it is the first.
    pub fn unrequested(&mut self, key: WindowKey, by: &str) -> bool {
        let (hob, boot, seq) = &key;
        let text = format!("to {hob} {boot} {seq}, is signed {by}");
        self.unrequested.add(text);
        self.expect_none(key);
        self.unrequested.answers == 1
    }

    /// Records that no answer to a window will arrive.
    pub fn expect_none(&mut self, key: WindowKey) {
        if self.early.len() >= MAX_EARLY {
            self.early.pop_first();
        }
        self.early.insert(key);
    }

    /// Returns `true` if no answer to a window will arrive.
    pub fn is_early(&self, key: &WindowKey) -> bool {
        self.early.contains(key)
    }

    /// Forgets a window that has its result.
    pub fn settled(&mut self, key: &WindowKey) {
        self.early.remove(key);
    }

    /// Returns the alarms.
    pub fn alarms(&self, now: Instant) -> impl Iterator<Item = String> {
        let foreign = "were for boots that this store does not know: either another daemon has a copy of it, or the name had another store";
        let unrequested = "came to windows that were never sent: a worker's key is misused. Windows to come are identified here";
        let foreign = self.foreign.alarm(now, foreign);
        let unrequested = self.unrequested.alarm(now, unrequested);
        foreign.into_iter().chain(unrequested)
    }
}
