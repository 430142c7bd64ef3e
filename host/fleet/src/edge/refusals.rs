//! Hobs of which the server refuses something, by part: each waits apart, so that none stops the other hobs of its edge.
//!
//! A refusal is the hob's own if the part served something else since the refusal began, and otherwise may be an outage.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use tokio::time::Instant;

/// Pause after a failure, and while the edge is not admitted.
pub const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Longest pause between two tries with a hob that alone is refused.
const MAX_PAUSE: Duration = Duration::from_secs(60);

/// Time after which a refusal is an alarm though nothing else is served.
const ALARM_AFTER: Duration = Duration::from_secs(60);

/// Most hobs that an alarm names.
const MAX_NAMED: usize = 5;

/// Present refusals.
#[derive(Debug, Default)]
pub struct Refusals {
    by_part: BTreeMap<(&'static str, String), Refusal>,
    /// Time at which each part last served something.
    served: BTreeMap<&'static str, Instant>,
}

#[derive(Debug)]
struct Refusal {
    why: String,
    since: Instant,
    times: u32,
    /// Time of the next try.
    next: Instant,
}

impl Refusals {
    /// Records that a part serves something.
    pub fn served(&mut self, part: &'static str, now: Instant) {
        self.served.insert(part, now);
    }

    /// Records that a part serves a hob; returns the number of its refusals before.
    pub fn accepted(&mut self, part: &'static str, hob: &str, now: Instant) -> u32 {
        self.served(part, now);
        let refusal = self.by_part.remove(&(part, hob.to_owned()));
        refusal.map_or(0, |refusal| refusal.times)
    }

    /// Records a refusal in a turn that began at `began`; returns `true` if it is the first.
    pub fn refused(&mut self, part: &'static str, hob: &str, why: &str, began: Instant) -> bool {
        let key = (part, hob.to_owned());
        let refusal = self.by_part.entry(key).or_insert(Refusal {
            why: String::new(),
            since: began,
            times: 0,
            next: began,
        });
        why.clone_into(&mut refusal.why);
        refusal.times += 1;
        let pause = match is_own(&self.served, part, refusal) {
            true => RETRY_PAUSE * 2_u32.saturating_pow(refusal.times.min(10) - 1),
            false => RETRY_PAUSE,
        };
        refusal.next = Instant::now() + pause.min(MAX_PAUSE);
        refusal.times == 1
    }

    /// Records what is wrong for certain of a hob alone.
    pub fn lacks(&mut self, part: &'static str, hob: &str, why: &str, now: Instant) -> bool {
        let is_first = self.refused(part, hob, why, now);
        self.served(part, now);
        if let Some(refusal) = self.by_part.get_mut(&(part, hob.to_owned())) {
            refusal.times = refusal.times.max(2);
        }
        is_first
    }

    /// Returns `true` unless a hob waits for its next try.
    pub fn may_try(&self, part: &'static str, hob: &str, now: Instant) -> bool {
        let refusal = self.by_part.get(&(part, hob.to_owned()));
        refusal.is_none_or(|refusal| refusal.next <= now)
    }

    /// Lets every hob try again at once, as after a connection.
    pub fn try_again(&mut self, now: Instant) {
        for refusal in self.by_part.values_mut() {
            refusal.next = now;
        }
    }

    /// Forgets hobs that the daemon has no more.
    pub fn keep(&mut self, hobs: &[String]) {
        self.by_part.retain(|(_, hob), _| hobs.contains(hob));
    }

    /// Returns the hobs that a part refuses.
    pub fn hobs(&self, part: &str) -> BTreeSet<String> {
        let of_part = self.by_part.keys().filter(|(other, _)| *other == part);
        of_part.map(|(_, hob)| hob.clone()).collect()
    }

    /// Returns `true` if every refusal of a part is its hob's own.
    pub fn are_own(&self, part: &str) -> bool {
        let mut of_part = self.by_part.iter().filter(|((other, _), _)| *other == part);
        of_part.all(|((part, _), refusal)| is_own(&self.served, part, refusal))
    }

    /// Returns the texts of refusals that may be an outage.
    pub fn of_outages(&self) -> impl Iterator<Item = String> {
        let outages = self.by_part.iter();
        let outages = outages.filter(|((part, _), refusal)| !is_own(&self.served, part, refusal));
        outages.map(|((part, hob), refusal)| format!("{part}: {hob}: {}", refusal.why))
    }

    /// Returns the alarms: refusals of a hob alone, and all that last.
    pub fn alarms(&self, now: Instant) -> Vec<String> {
        let mut by_hob: BTreeMap<&str, (Vec<&str>, &str)> = BTreeMap::new();
        for ((part, hob), refusal) in &self.by_part {
            let own = refusal.times > 1 && is_own(&self.served, part, refusal);
            if own || now.duration_since(refusal.since) > ALARM_AFTER {
                let (parts, _) = by_hob.entry(hob).or_insert((Vec::new(), &refusal.why));
                parts.push(part);
            }
        }
        let mut by_cause: BTreeMap<(Vec<&str>, &str), Vec<&str>> = BTreeMap::new();
        for (hob, cause) in by_hob {
            by_cause.entry(cause).or_default().push(hob);
        }
        let text = |((parts, why), hobs): ((Vec<&str>, &str), Vec<&str>)| {
            let mut named = hobs[..hobs.len().min(MAX_NAMED)].join(", ");
            if hobs.len() > MAX_NAMED {
                named += &format!(" and {} more", hobs.len() - MAX_NAMED);
            }
            let parts = parts.join(", ");
            format!(
                "the fleet refuses hob {named} ({parts}): {why}{}",
                advice(why)
            )
        };
        by_cause.into_iter().map(text).collect()
    }
}

fn is_own(served: &BTreeMap<&str, Instant>, part: &str, refusal: &Refusal) -> bool {
    served.get(part).is_some_and(|at| *at >= refusal.since)
}

/// Returns what to do, where the server's text does not say so.
fn advice(why: &str) -> &'static str {
    if why.contains("timed out") {
        "; either this key may not do that (the server's log says so), or the server's disk was full: restart the server once it has room"
    } else if why.contains("no responders") || why.contains("no stream found") {
        "; is the hob in nats.conf (`ihd-fleet init server-config`)?"
    } else if why.contains("maximum") {
        "; workers, or a larger queue (`ihd-fleet init --windows-bytes`)"
    } else {
        ""
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);
    const NONE: &str = "no responders";

    #[tokio::test(start_paused = true)]
    async fn a_hob_that_alone_is_refused_waits_longer_and_is_an_alarm() {
        let mut refusals = Refusals::default();
        let mut pauses = Vec::new();
        for turn in 0..8 {
            let now = Instant::now();
            assert_eq!(refusals.refused("sending", "aaa", NONE, now), turn == 0);
            assert_eq!(refusals.accepted("sending", "test", now), 0);
            assert!(refusals.may_try("sending", "test", now));
            let alarms = refusals.alarms(now);
            assert_eq!(alarms.len(), usize::from(turn > 0), "{alarms:?}");
            assert!(alarms.iter().all(|text| text.contains("hob aaa (sending)")));
            while !refusals.may_try("sending", "aaa", Instant::now()) {
                tokio::time::advance(S).await;
            }
            pauses.push(now.elapsed().as_secs());
        }
        assert_eq!(pauses, [2, 4, 8, 16, 32, 60, 60, 60]);
        assert!(refusals.are_own("sending"));
        assert_eq!(refusals.accepted("sending", "aaa", Instant::now()), 8);
        assert_eq!(refusals.alarms(Instant::now()), [""; 0]);
    }

    #[tokio::test(start_paused = true)]
    async fn an_outage_is_no_hobs_own_and_an_alarm_once_it_lasts() {
        let mut refusals = Refusals::default();
        refusals.served("sending", Instant::now());
        for second in 1..=62 {
            tokio::time::advance(S).await;
            for hob in ["a", "b"] {
                if refusals.may_try("sending", hob, Instant::now()) {
                    refusals.refused("sending", hob, "timed out", Instant::now());
                }
            }
            let alarms = refusals.alarms(Instant::now());
            assert_eq!(
                alarms.len(),
                usize::from(second > 61),
                "{second}: {alarms:?}"
            );
        }
        assert!(!refusals.are_own("sending"));
        let alarms = refusals.alarms(Instant::now());
        assert!(alarms[0].contains("hob a, b (sending)"), "{alarms:?}");
        assert!(alarms[0].contains("disk was full: restart"), "{alarms:?}");
    }
}
