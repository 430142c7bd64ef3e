//! Program flow: rate of each task, between two limits.

use crate::drive::pwm::CORE_HZ;

/// Length of the window in which rates are judged, in cycles of the processor: 100 ms.
pub const WINDOW_CYCLES: u32 = CORE_HZ / 10;

/// Difference between the time that blocks should have taken and the time that passed, in per mille. Two lost blocks a
/// half-cycle of 50 Hz, which are allowed, are 18 at 34 kHz; a block of another frequency at a step is 1.
const MAX_OFF_PERMILLE: u32 = 50;

/// Turns of housekeeping in a window: on the emulated chip there are some 2 000, the longest pause is 0.5 ms
/// (docs/board.md).
const MIN_TURNS: u32 = 50;

/// Counts of each task; all of them wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskCounts {
    /// Cycles that the blocks which the sampling path took should have lasted.
    pub sampled_cycles: u32,
    /// Blocks that it took.
    pub blocks: u32,
    /// Turns of housekeeping.
    pub turns: u32,
    /// Answers of the task that keeps lookups; it is called once a window.
    pub answers: u32,
}

/// A task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The sampling path.
    Sampling,
    /// Control and link.
    Housekeeping,
    /// Task that keeps lookups in flash.
    Keep,
}

/// Result of a check of the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// The window is not over.
    Pending,
    /// Every task ran at its rate; the task that keeps lookups is due again.
    Passed,
    /// This task did not run at its rate.
    Failed(Task),
}

/// The watch over all tasks.
#[derive(Clone, Copy, Debug)]
pub struct ProgramFlow {
    began_at: u32,
    before: TaskCounts,
    right: bool,
}

impl ProgramFlow {
    /// Begins a window now; the task that keeps lookups has been called.
    pub fn new(now_cycles: u32, counts: TaskCounts) -> Self {
        Self {
            began_at: now_cycles,
            before: counts,
            right: true,
        }
    }

    /// Looks at the counts; called more often than every 10 ms. The window ends by the clock that is ahead: the other may stand
    /// still.
    pub fn check(&mut self, now_cycles: u32, counts: TaskCounts) -> Flow {
        let passed = now_cycles.wrapping_sub(self.began_at);
        let sampled = counts
            .sampled_cycles
            .wrapping_sub(self.before.sampled_cycles);
        if passed.max(sampled) < WINDOW_CYCLES {
            return Flow::Pending;
        }
        let wrong = self.wrong(passed, sampled, counts);
        *self = Self::new(now_cycles, counts);
        self.right = wrong.is_none();
        wrong.map_or(Flow::Passed, Flow::Failed)
    }

    /// Returns `true` if all was right in the last window: only then may a bridge that is not open have its watchdog fed.
    pub fn is_right(&self) -> bool {
        self.right
    }

    fn wrong(&self, passed: u32, sampled: u32, counts: TaskCounts) -> Option<Task> {
        let since = |now: u32, before: u32| now.wrapping_sub(before);
        let blocks = since(counts.blocks, self.before.blocks);
        let turns = since(counts.turns, self.before.turns);
        let answers = since(counts.answers, self.before.answers);
        let off = u64::from(sampled.abs_diff(passed)) * 1_000;
        if off > u64::from(passed) * u64::from(MAX_OFF_PERMILLE) {
            Some(Task::Sampling)
        } else if turns < MIN_TURNS || turns > blocks.saturating_add(2) {
            Some(Task::Housekeeping)
        } else if answers != 1 {
            Some(Task::Keep)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window in which each task runs at a multiple of its rate.
    fn window(sampling: f64, turns_a_block: f64, answers: u32) -> Flow {
        let began = u32::MAX - 1_000;
        let before = TaskCounts {
            sampled_cycles: u32::MAX - 7,
            blocks: u32::MAX,
            turns: 3,
            answers: u32::MAX,
        };
        let mut flow = ProgramFlow::new(began, before);
        let block_cycles = 6_382;
        for blocks in 1..10_000u32 {
            let passed = (f64::from(blocks * block_cycles) / sampling) as u32;
            let counts = TaskCounts {
                sampled_cycles: before.sampled_cycles.wrapping_add(blocks * block_cycles),
                blocks: before.blocks.wrapping_add(blocks),
                turns: before.turns + (f64::from(blocks) * turns_a_block) as u32,
                answers: before.answers.wrapping_add(answers),
            };
            match flow.check(began.wrapping_add(passed), counts) {
                Flow::Pending => {}
                verdict => {
                    assert_eq!(flow.is_right(), verdict == Flow::Passed);
                    return verdict;
                }
            }
        }
        Flow::Pending
    }

    #[test]
    fn each_task_has_a_rate_with_two_limits() {
        assert_eq!(window(1.0, 1.0, 1), Flow::Passed);
        assert_eq!(window(0.97, 0.2, 1), Flow::Passed);
        // At last a main clock that stands still.
        for rate in [0.5, 0.9, 1.1, 2.0, f64::INFINITY] {
            assert_eq!(window(rate, 1.0, 1), Flow::Failed(Task::Sampling), "{rate}");
        }
        for turns in [0.01, 2.0] {
            assert_eq!(
                window(1.0, turns, 1),
                Flow::Failed(Task::Housekeeping),
                "{turns}"
            );
        }
        for answers in [0, 2] {
            assert_eq!(window(1.0, 1.0, answers), Flow::Failed(Task::Keep));
        }
    }
}
