//! Present failures: each cause is logged once, then counted until the part works again. One that lasts is an alarm.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::Instant;

/// Most logged texts of one part; further ones are only counted.
const MAX_TEXTS: usize = 8;

/// Time for which a part fails again and again before an alarm: longer than a restart of the server.
const ALARM_AFTER: Duration = Duration::from_secs(600);

/// Present failures by part.
#[derive(Debug, Default)]
pub struct Faults {
    by_part: BTreeMap<&'static str, Fault>,
}

#[derive(Debug)]
struct Fault {
    last: String,
    logged: Vec<String>,
    times: u64,
    first_at: Instant,
    last_at: Instant,
}

impl Faults {
    /// Records a failure; returns `true` if it is to be logged: new since the part last worked.
    pub fn failed(&mut self, part: &'static str, why: &str, now: Instant) -> bool {
        let fault = self.by_part.entry(part).or_insert_with(|| Fault {
            last: String::new(),
            logged: Vec::new(),
            times: 0,
            first_at: now,
            last_at: now,
        });
        fault.times += 1;
        fault.last_at = now;
        why.clone_into(&mut fault.last);
        let is_new = fault.logged.len() < MAX_TEXTS && !fault.logged.iter().any(|text| text == why);
        if is_new {
            fault.logged.push(why.to_owned());
        }
        is_new
    }

    /// Clears a part that works; returns the number of its failures.
    pub fn works(&mut self, part: &str) -> u64 {
        self.by_part.remove(part).map_or(0, |fault| fault.times)
    }

    /// Returns the alarms: parts that have failed again and again for long, and lately.
    pub fn alarms(&self, now: Instant) -> Vec<String> {
        let lasts = |fault: &Fault| {
            fault.last_at.duration_since(fault.first_at) >= ALARM_AFTER
                && now.duration_since(fault.last_at) < ALARM_AFTER
        };
        let lasting = self.by_part.iter().filter(|(_, fault)| lasts(fault));
        let text = |(part, fault): (&&str, &Fault)| {
            let minutes = now.duration_since(fault.first_at).as_secs() / 60;
            format!(
                "the edge's part {part:?} fails for {minutes} min: {}",
                fault.last
            )
        };
        lasting.map(text).collect()
    }

    /// Returns the text of all present failures, empty without any.
    pub fn text(&self) -> String {
        let text = |(part, fault): (&&str, &Fault)| match fault.times {
            1 => format!("{part}: {}", fault.last),
            times => format!("{part}: {} ({times} times)", fault.last),
        };
        self.by_part.iter().map(text).collect::<Vec<_>>().join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_again_and_again_is_told_once_and_counted() {
        let (mut faults, now) = (Faults::default(), Instant::now());
        // Two parts in turn, one of them with two causes in turn.
        let logged = (0..100).map(|k| {
            let why = ["no answer", "no stream"][k % 2];
            u32::from(faults.failed("results", why, now))
                + u32::from(faults.failed("pots", "none", now))
        });
        assert_eq!(logged.sum::<u32>(), 3);
        assert_eq!(
            faults.text(),
            "pots: none (100 times); results: no stream (100 times)"
        );
        assert_eq!(faults.works("results"), 100);
        assert_eq!(faults.works("results"), 0);
        assert_eq!(faults.text(), "pots: none (100 times)");
        assert!(
            faults.failed("results", "no answer", now),
            "it had worked between"
        );
        assert_eq!(faults.text(), "pots: none (100 times); results: no answer");
    }

    #[test]
    fn texts_that_differ_each_time_do_not_fill_the_log() {
        let (mut faults, now) = (Faults::default(), Instant::now());
        let logged = (0..1_000).filter(|k| faults.failed("lookups", &format!("{k}"), now));
        assert_eq!(logged.count(), MAX_TEXTS);
    }

    #[test]
    fn a_part_that_fails_for_long_is_an_alarm_until_it_works_or_is_tried_no_more() {
        let (mut faults, began) = (Faults::default(), Instant::now());
        let after = |seconds| began + Duration::from_secs(seconds);
        faults.failed("events", "no stream", began);
        faults.failed("pots", "none", began);
        faults.failed("events", "no stream", after(599));
        assert_eq!(faults.alarms(after(600)), [""; 0]);
        faults.failed("events", "no answer", after(660));
        assert_eq!(
            faults.alarms(after(700)),
            ["the edge's part \"events\" fails for 11 min: no answer"]
        );
        assert_eq!(faults.alarms(after(1_260)), [""; 0]);
        faults.failed("events", "no answer", after(1_300));
        assert_eq!(faults.alarms(after(1_300)).len(), 1);
        faults.works("events");
        assert_eq!(faults.alarms(after(1_300)), [""; 0]);
    }
}
