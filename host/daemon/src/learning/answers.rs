//! Record of each worker's answers, by its name: who was caught, how often, and with what.

use std::collections::BTreeMap;

/// Workers that are remembered; of more, the one that was heard of longest ago is forgotten.
const MOST_WORKERS: usize = 256;

/// Refuted answers of a worker after which nothing of it is believed until the daemon starts again.
const MOST_REFUTED: u64 = 3;

/// Outcome of an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The samples confirm it.
    Confirmed,
    /// The samples refute it; why.
    Refuted(String),
    /// It was found with other corrections of the sensors.
    Outdated,
    /// The worker found nothing.
    Unidentified,
    /// Its worker was caught before: nobody looked at it.
    Distrusted,
}

/// Answers of one worker.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkerFigures {
    /// Answers that the samples confirm.
    pub confirmed: u64,
    /// Answers that the samples refute.
    pub refuted: u64,
    /// Answers that were found with other corrections of the sensors.
    pub outdated: u64,
    /// Windows in which it found nothing.
    pub unidentified: u64,
    /// Answers that nobody looked at, since it was caught too often.
    pub distrusted: u64,
    /// Reason for which the last answer was refuted; empty where none was.
    pub why: String,
    /// Number of answers of all workers before its last.
    last: u64,
}

impl WorkerFigures {
    /// Returns `true` once it was caught so often that nothing of it is believed.
    pub fn is_distrusted(&self) -> bool {
        self.refuted >= MOST_REFUTED
    }
}

/// Records of all workers.
#[derive(Debug, Default)]
pub struct Answers {
    workers: BTreeMap<String, WorkerFigures>,
    count: u64,
}

impl Answers {
    /// Returns `true` where answers of this worker are not to be looked at.
    pub fn distrust(&self, worker: &str) -> bool {
        self.workers
            .get(worker)
            .is_some_and(WorkerFigures::is_distrusted)
    }

    /// Records an answer; returns `true` where it is the one after which its worker is distrusted.
    pub fn note(&mut self, worker: &str, standing: Standing) -> bool {
        self.count += 1;
        if !self.workers.contains_key(worker) && self.workers.len() >= MOST_WORKERS {
            self.forget_one();
        }
        let figures = self.workers.entry(worker.to_owned()).or_default();
        figures.last = self.count;
        match standing {
            Standing::Confirmed => figures.confirmed += 1,
            Standing::Outdated => figures.outdated += 1,
            Standing::Unidentified => figures.unidentified += 1,
            Standing::Distrusted => figures.distrusted += 1,
            Standing::Refuted(why) => {
                figures.refuted += 1;
                figures.why = why;
                return figures.refuted == MOST_REFUTED;
            }
        }
        false
    }

    /// Records by name.
    pub fn workers(&self) -> &BTreeMap<String, WorkerFigures> {
        &self.workers
    }

    /// Forgets one that was never caught before one that was.
    fn forget_one(&mut self) {
        let least = self
            .workers
            .iter()
            .min_by_key(|(_, figures)| (figures.refuted, figures.last));
        if let Some(name) = least.map(|(name, _)| name.clone()) {
            self.workers.remove(&name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refuted() -> Standing {
        Standing::Refuted("R 15 % high".to_owned())
    }

    #[test]
    fn the_third_refuted_answer_is_the_last_that_is_looked_at() {
        let mut answers = Answers::default();
        for k in 1..=3 {
            assert!(!answers.distrust("liar"));
            answers.note("honest", Standing::Confirmed);
            assert_eq!(answers.note("liar", refuted()), k == 3);
        }
        assert!(answers.distrust("liar") && !answers.distrust("honest"));
        assert_eq!(answers.workers()["liar"].why, "R 15 % high");
        assert!(!answers.note("liar", Standing::Distrusted));
    }

    /// A liar that takes a new name for each answer fills no memory and drives nobody out who was caught.
    #[test]
    fn names_without_end_are_forgotten_and_who_was_caught_is_not() {
        let mut answers = Answers::default();
        for _ in 0..3 {
            answers.note("liar", refuted());
        }
        for k in 0..10_000 {
            answers.note(&format!("w{k}"), Standing::Confirmed);
        }
        assert!(answers.distrust("liar"));
        assert_eq!(answers.workers().len(), MOST_WORKERS);
    }
}
