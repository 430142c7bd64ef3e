//! Fit of one window: from a worker's answer if the window confirms it, otherwise by the network here.

use std::time::Duration;

use ihd_link::Window;
use ihd_signal::truth::Truth;
use ihd_train::learning::{AnswerError, ConfirmedAnswer, LookupUpdate, WindowOutcome};

use super::answer::{StatedLoad, WorkerAnswer};
use super::fit::{FitSummary, FitTrace, fit_remark};
use super::job::{LearnInput, LearnJob};
use super::queue::DeviceLearning;
use super::shared::{Shared, guarded};
use super::workers::AnswerVerdict;

/// Fits R and L to a window: by a worker's answer if the window confirms it, otherwise by the network here. A window that came too late
/// has a result and teaches nothing.
pub(super) fn fit_window(
    shared: &Shared,
    device_learning: &mut DeviceLearning,
    job: &LearnJob,
) -> WindowResult {
    if let LearnInput::Answered(window, answer) = &job.input
        && let Some(result) = learn_from_answer(shared, device_learning, job.boot, window, answer)
    {
        return result;
    }
    let window = job.input.window();
    let learning = &mut device_learning.learning;
    let is_late = match &job.input {
        // The device sends its windows in their order.
        LearnInput::Window(_) => !learning.is_present(job.boot),
        LearnInput::Answered(window, _) => learning.is_late(job.boot, window),
    };
    let outcome = match is_late {
        true => (shared.observe)(&mut learning.clone(), window),
        false => (shared.observe)(learning, window),
    };
    WindowResult::from_outcome(window, outcome, job.truth.as_ref()).unless_late(is_late)
}

/// Learns from a worker's answer if the window confirms it; `None` if it does not. The verdict is recorded for the worker either way.
fn learn_from_answer(
    shared: &Shared,
    device_learning: &mut DeviceLearning,
    boot: u32,
    window: &Window,
    answer: &WorkerAnswer,
) -> Option<WindowResult> {
    let record = |verdict| record_answer(shared, answer, window.seq, verdict);
    let stated = match &answer.load {
        _ if shared.lock().workers.is_distrusted(&answer.by) => {
            record(AnswerVerdict::Distrusted);
            return None;
        }
        Err(_) => {
            record(AnswerVerdict::Unidentified);
            return None;
        }
        Ok(stated) => stated,
    };
    let skew_s = device_learning.learning.correction().map(|c| c.skew_s);
    let learned = guarded(shared, device_learning, |device_learning| {
        device_learning
            .learning
            .learn_from_answer(boot, window, &stated.claim())
    });
    let verdict = match learned {
        Ok(Ok(confirmed)) => {
            record(AnswerVerdict::Confirmed);
            return Some(WindowResult::from_answer(
                window,
                stated.clone(),
                confirmed,
                answer.busy,
            ));
        }
        Ok(Err(AnswerError::Refuted(why))) if !skews_differ(skew_s, answer.skew_s) => {
            AnswerVerdict::Refuted(why.to_string())
        }
        Ok(Err(_)) => AnswerVerdict::Outdated,
        Err(panic) => AnswerVerdict::Refuted(panic),
    };
    record(verdict);
    None
}

/// Largest difference of two skews in seconds at which R and L still agree within the check's limits.
const SAME_SKEW_S: f64 = 1e-9;

fn skews_differ(a: Option<f64>, b: Option<f64>) -> bool {
    (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs() > SAME_SKEW_S
}

fn record_answer(shared: &Shared, answer: &WorkerAnswer, seq: u32, verdict: AnswerVerdict) {
    let by = &answer.by;
    if let AnswerVerdict::Refuted(why) = &verdict {
        tracing::warn!(
            worker = by,
            seq,
            why,
            "a worker's answer is refuted by its window"
        );
    }
    if shared.lock().workers.record(by, verdict) {
        tracing::error!(
            worker = by,
            "too many of a worker's answers were refuted: it is ignored from now on"
        );
    }
}

/// Result of a window, before it is stored.
pub(super) struct WindowResult {
    pub(super) seq: u32,
    pub(super) half_cycle: u32,
    pub(super) f_sw_hz: u32,
    pub(super) summary: FitSummary,
    pub(super) trace: FitTrace,
    pub(super) refused: Option<String>,
    pub(super) update: LookupUpdate,
    /// `true` if the window came too late to be learned.
    pub(super) is_late: bool,
    pub(super) busy: Duration,
}

impl WindowResult {
    fn from_outcome(window: &Window, outcome: WindowOutcome, truth: Option<&Truth>) -> Self {
        let (identified, findings, refused, update) = match outcome {
            WindowOutcome::Accepted(fit) => (Some(fit.identified), fit.findings, None, fit.taught),
            WindowOutcome::Refused {
                why,
                identified,
                findings,
            } => (
                identified.map(|i| *i),
                findings,
                Some(why),
                LookupUpdate::Unchanged,
            ),
        };
        let identified = identified.as_ref();
        Self {
            seq: window.seq,
            half_cycle: window.half_cycle,
            f_sw_hz: window.f_sw_hz,
            summary: identified.map_or(FitSummary::NONE, FitSummary::from_identified),
            trace: FitTrace::new(identified, &findings, truth),
            refused,
            update,
            is_late: false,
            busy: Duration::ZERO,
        }
    }

    /// Takes away what the window would have taught if it came too late.
    fn unless_late(self, is_late: bool) -> Self {
        if !is_late {
            return self;
        }
        tracing::info!(
            seq = self.seq,
            "a window came too late to update the lookup"
        );
        Self {
            update: LookupUpdate::Unchanged,
            is_late,
            ..self
        }
    }

    /// Creates the result of a window whose identification panicked.
    pub(super) fn unfit(window: &Window, why: String, busy: Duration) -> Self {
        let unfit = WindowOutcome::Refused {
            why,
            identified: None,
            findings: Vec::new(),
        };
        Self {
            busy,
            ..Self::from_outcome(window, unfit, None)
        }
    }

    fn from_answer(
        window: &Window,
        mut stated: StatedLoad,
        answer: ConfirmedAnswer,
        busy: Duration,
    ) -> Self {
        stated
            .remarks
            .extend(answer.findings.iter().map(fit_remark));
        let result = Self {
            seq: window.seq,
            half_cycle: window.half_cycle,
            f_sw_hz: window.f_sw_hz,
            summary: stated.summary(&answer.confirmed),
            trace: stated.into_trace(answer.confirmed),
            refused: None,
            update: answer.taught,
            is_late: false,
            busy,
        };
        result.unless_late(answer.seen.is_none())
    }
}
