//! Present failures: each cause is logged once, then counted until the part works again.

use std::collections::BTreeMap;

/// Most logged texts of one part; further ones are only counted.
const MAX_TEXTS: usize = 8;

/// Present failures by part.
#[derive(Debug, Default)]
pub struct Faults {
    by_part: BTreeMap<&'static str, Fault>,
}

#[derive(Debug, Default)]
struct Fault {
    last: String,
    logged: Vec<String>,
    times: u64,
}

impl Faults {
    /// Records a failure; returns `true` if it is to be logged: new since the part last worked.
    pub fn failed(&mut self, part: &'static str, why: &str) -> bool {
        let fault = self.by_part.entry(part).or_default();
        fault.times += 1;
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
        let mut faults = Faults::default();
        // Two parts in turn, one of them with two causes in turn.
        let logged = (0..100).map(|k| {
            let why = ["no answer", "no stream"][k % 2];
            u32::from(faults.failed("results", why)) + u32::from(faults.failed("pots", "none"))
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
            faults.failed("results", "no answer"),
            "it had worked between"
        );
        assert_eq!(faults.text(), "pots: none (100 times); results: no answer");
    }

    #[test]
    fn texts_that_differ_each_time_do_not_fill_the_log() {
        let mut faults = Faults::default();
        let logged = (0..1_000).filter(|k| faults.failed("lookups", &format!("{k}")));
        assert_eq!(logged.count(), MAX_TEXTS);
    }
}
