//! Records of workers' answers by name: numbers of confirmed and refuted ones, and the last reason.

use std::collections::BTreeMap;

use ihd_model::FleetAnswers;

/// Most workers in the records; beyond it, the one with the fewest refuted answers and the oldest last answer is removed.
const MAX_WORKERS: usize = 256;

/// Refuted answers of a worker after which all its answers are ignored until the daemon restarts.
const MAX_REFUTED: u64 = 3;

/// Verdict on a worker's answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AnswerVerdict {
    /// Confirmed by the window's samples.
    Confirmed,
    /// Refuted by the window's samples, with the reason.
    Refuted(String),
    /// Computed with another sensor correction.
    Outdated,
    /// Without a result.
    Unidentified,
    /// Ignored, because the worker is distrusted.
    Distrusted,
}

/// Numbers of one worker's answers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkerFigures {
    /// Answers that the samples confirm.
    pub confirmed: u64,
    /// Answers that the samples refute.
    pub refuted: u64,
    /// Answers that were computed with another sensor correction.
    pub outdated: u64,
    /// Answers without a result.
    pub unidentified: u64,
    /// Answers that were ignored, because the worker is distrusted.
    pub distrusted: u64,
    /// Reason of the last refutation; empty if none.
    pub why: String,
    /// Number of its last answer among those of all workers.
    last: u64,
}

impl WorkerFigures {
    /// Returns `true` if so many of its answers were refuted that the rest are ignored.
    pub fn is_distrusted(&self) -> bool {
        self.refuted >= MAX_REFUTED
    }
}

/// Sums the answers of workers.
pub fn sum_answers<'a>(workers: impl Iterator<Item = &'a WorkerFigures>) -> FleetAnswers {
    workers.fold(FleetAnswers::default(), |sum, worker| FleetAnswers {
        confirmed: sum.confirmed + worker.confirmed,
        refuted: sum.refuted + worker.refuted,
        outdated: sum.outdated + worker.outdated,
        unidentified: sum.unidentified + worker.unidentified,
        distrusted: sum.distrusted + worker.distrusted,
    })
}

/// Records of all workers.
#[derive(Debug, Default)]
pub struct WorkerRecords {
    workers: BTreeMap<String, WorkerFigures>,
    count: u64,
}

impl WorkerRecords {
    /// Returns `true` if answers of this worker are ignored.
    pub fn is_distrusted(&self, worker: &str) -> bool {
        self.workers
            .get(worker)
            .is_some_and(WorkerFigures::is_distrusted)
    }

    /// Records an answer; returns `true` if its worker is distrusted from now on.
    pub fn record(&mut self, worker: &str, verdict: AnswerVerdict) -> bool {
        self.count += 1;
        if !self.workers.contains_key(worker) && self.workers.len() >= MAX_WORKERS {
            self.forget_one();
        }
        let figures = self.workers.entry(worker.to_owned()).or_default();
        figures.last = self.count;
        match verdict {
            AnswerVerdict::Confirmed => figures.confirmed += 1,
            AnswerVerdict::Outdated => figures.outdated += 1,
            AnswerVerdict::Unidentified => figures.unidentified += 1,
            AnswerVerdict::Distrusted => figures.distrusted += 1,
            AnswerVerdict::Refuted(why) => {
                figures.refuted += 1;
                figures.why = why;
                return figures.refuted == MAX_REFUTED;
            }
        }
        false
    }

    /// Returns the records by name.
    pub fn workers(&self) -> &BTreeMap<String, WorkerFigures> {
        &self.workers
    }

    /// Removes the worker with the fewest refuted answers, of these the one with the oldest last answer.
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

    fn refuted() -> AnswerVerdict {
        AnswerVerdict::Refuted("R 15 % high".to_owned())
    }

    #[test]
    fn a_worker_is_distrusted_after_three_refuted_answers() {
        let mut records = WorkerRecords::default();
        for k in 1..=3 {
            assert!(!records.is_distrusted("liar"));
            records.record("honest", AnswerVerdict::Confirmed);
            assert_eq!(records.record("liar", refuted()), k == 3);
        }
        assert!(records.is_distrusted("liar") && !records.is_distrusted("honest"));
        assert_eq!(records.workers()["liar"].why, "R 15 % high");
        assert!(!records.record("liar", AnswerVerdict::Distrusted));
    }

    /// A worker that takes a new name for each answer neither fills the memory nor removes the record of a distrusted one.
    #[test]
    fn the_number_of_records_is_bounded_and_distrusted_workers_stay() {
        let mut records = WorkerRecords::default();
        for _ in 0..3 {
            records.record("liar", refuted());
        }
        for k in 0..10_000 {
            records.record(&format!("w{k}"), AnswerVerdict::Confirmed);
        }
        assert!(records.is_distrusted("liar"));
        assert_eq!(records.workers().len(), MAX_WORKERS);
    }
}
