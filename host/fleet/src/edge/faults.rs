//! Present failures: each cause is told once, then counted until it works again.

use std::collections::BTreeMap;

/// Texts of one part that are told; what it says beside them is counted alone.
const MOST_TEXTS: usize = 8;

/// Present failures by part.
#[derive(Debug, Default)]
pub struct Faults {
    of: BTreeMap<&'static str, Fault>,
}

#[derive(Debug, Default)]
struct Fault {
    last: String,
    told: Vec<String>,
    times: u64,
}

impl Faults {
    /// Notes what failed; `true` where it is to be told, because it was not since that part worked last.
    pub fn failed(&mut self, part: &'static str, why: &str) -> bool {
        let fault = self.of.entry(part).or_default();
        fault.times += 1;
        why.clone_into(&mut fault.last);
        let is_news = fault.told.len() < MOST_TEXTS && !fault.told.iter().any(|told| told == why);
        if is_news {
            fault.told.push(why.to_owned());
        }
        is_news
    }

    /// A part works; how often it had failed.
    pub fn works(&mut self, part: &str) -> u64 {
        self.of.remove(part).map_or(0, |fault| fault.times)
    }

    /// All that fails now, in words; empty where nothing does.
    pub fn text(&self) -> String {
        let text = |(part, fault): (&&str, &Fault)| match fault.times {
            1 => format!("{part}: {}", fault.last),
            times => format!("{part}: {} ({times} times)", fault.last),
        };
        self.of.iter().map(text).collect::<Vec<_>>().join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_again_and_again_is_told_once_and_counted() {
        let mut faults = Faults::default();
        // Two parts in turn, one of them with two causes in turn.
        let told = (0..100).map(|k| {
            let why = ["no answer", "no stream"][k % 2];
            u32::from(faults.failed("results", why)) + u32::from(faults.failed("pots", "none"))
        });
        assert_eq!(told.sum::<u32>(), 3);
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
        let told = (0..1_000).filter(|k| faults.failed("lookups", &format!("{k}")));
        assert_eq!(told.count(), MOST_TEXTS);
    }
}
