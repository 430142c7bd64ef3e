//! Runs of the matrix: every case is simulated once, gets each seed's noise, and is processed like by `ihd identify`.

use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_gate::{Examination, ExamineOptions, Reconstruct, examine};
use ihd_identify::{IdentifyOptions, Method};
use ihd_signal::{Capture, Severity};
use ihd_sim::inverter::InverterError;
use ihd_sim::recording::run::{SimulatedRecording, record};
use ihd_survey::Hints;
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};
use serde::Serialize;

use super::case::{CaptureGroup, Case};
use super::cases::all;
use super::score::{CaseTruth, ResultJudgement, StretchErrors, errors, larger};
use crate::parallel::in_parallel;

/// Plan of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct HostilePlan {
    /// Estimators.
    pub methods: Vec<Method>,
    /// Seeds of the noise, of captures that have some.
    pub seeds: u64,
    /// Part of the names of the cases to run; `None` for all.
    pub only: Option<String>,
    /// `true` to run the short form only.
    pub short: bool,
}

impl HostilePlan {
    /// Cases of the plan.
    pub fn cases(&self) -> Vec<Case> {
        let named = |case: &Case| {
            self.only
                .as_ref()
                .is_none_or(|only| case.name.contains(only.as_str()))
        };
        all()
            .into_iter()
            .filter(|case| (case.short || !self.short) && named(case))
            .collect()
    }
}

/// Results of a method on a case with one seed, over all stretches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HostileRun {
    /// Name of the case.
    pub case: String,
    /// Soundness of the case.
    pub group: CaptureGroup,
    /// Seed of the noise.
    pub seed: u64,
    /// Method.
    pub method: Method,
    /// Number of identified stretches.
    pub stretches: usize,
    /// Largest errors of the stretches; `None` without an estimate.
    pub errors: Option<StretchErrors>,
    /// `true` if a stretch was refused, or nothing could be identified.
    pub refused: bool,
    /// Codes of the findings with severity warning or error, each once.
    #[serde(rename = "said")]
    pub codes: Vec<String>,
    /// Worst judgement of the stretches.
    pub judged: ResultJudgement,
    /// Largest error over σ of a stretch that passed without a finding, but of a defect that no capture can show.
    #[serde(rename = "unsaid_per_sigma")]
    pub unremarked_per_sigma: Option<f64>,
    /// Reason why there is no estimate, or the first reason of a refusal.
    pub why: Option<String>,
    /// Wall-clock time of the methods alone in seconds.
    pub elapsed_s: f64,
}

/// Error of the simulator for a case.
#[derive(Debug, thiserror::Error)]
#[error("{case}: {source}")]
pub struct HostileError {
    /// Name of the case.
    case: String,
    /// Error.
    source: InverterError,
}

/// Runs the plan on all cores; the result does not depend on their number. `progress` is called with the numbers of finished and of
/// all cases. Runs are ordered by case, seed and method.
///
/// # Errors
/// [`HostileError`].
pub fn study(
    plan: &HostilePlan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<HostileRun>, HostileError> {
    let cases = plan.cases();
    let done = AtomicUsize::new(0);
    let results = in_parallel(&cases, |case| {
        let runs = run_case(plan, case);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, cases.len());
        runs
    });
    let mut runs = Vec::new();
    for (case, result) in cases.iter().zip(results) {
        runs.extend(result.map_err(|source| HostileError {
            case: case.name.clone(),
            source,
        })?);
    }
    Ok(runs)
}

fn run_case(plan: &HostilePlan, case: &Case) -> Result<Vec<HostileRun>, InverterError> {
    let recording = record(&case.settings, |_| ())?;
    let truth = CaseTruth::new(&case.settings, &recording.truth);
    let mut runs = Vec::new();
    for seed in 1..=case.seeds(plan.seeds) {
        let capture = capture(case, &recording.with_seed(seed));
        runs.extend(examined(plan, case, seed, &capture, &truth));
    }
    Ok(runs)
}

/// User's view of the recording: two waveforms and their times, without the specification.
fn capture(case: &Case, recording: &SimulatedRecording) -> Capture {
    let mut capture = Capture {
        v_full_scale_v: None,
        i_full_scale_a: None,
        f_sw: Vec::new(),
        mains_hz: None,
        zero_crossing_s: None,
        truth: Vec::new(),
        ..recording.capture(&case.name)
    };
    for damage in &case.damage {
        damage.apply(&mut capture);
    }
    capture
}

fn examined(
    plan: &HostilePlan,
    case: &Case,
    seed: u64,
    capture: &Capture,
    truth: &CaseTruth<'_>,
) -> Vec<HostileRun> {
    let mut settings = IdentifyOptions::default();
    // The result must not depend on the machine's load.
    settings.pinn.deterministic = true;
    let methods: Vec<Method> = (plan.methods.iter().copied())
        .filter(|method| case.suits(*method))
        .collect();
    let request = ExamineOptions {
        hints: Hints::default(),
        methods: &methods,
        sensors: BlindOptions {
            mode: CalibrationMode::Auto,
            capacitance_f: case.capacitance_f,
        },
        settings: &settings,
        reconstruct: Reconstruct::No,
    };
    let examined = examine(capture, &request, &mut |_, _, _| ());
    let of_method = |&method: &Method| {
        let nothing = HostileRun {
            case: case.name.clone(),
            group: case.group,
            seed,
            method,
            stretches: 0,
            errors: None,
            refused: false,
            codes: Vec::new(),
            judged: ResultJudgement::Right,
            unremarked_per_sigma: None,
            why: None,
            elapsed_s: 0.0,
        };
        match &examined {
            Ok(examined) => together(nothing, examined, truth),
            Err(error) => HostileRun {
                refused: true,
                codes: vec!["nothing_to_work_on".to_owned()],
                judged: ResultJudgement::judge(case.group, None, true, false),
                why: Some(error.to_string()),
                ..nothing
            },
        }
    };
    methods.iter().map(of_method).collect()
}

/// Combines all stretches of a method.
fn together(mut run: HostileRun, examined: &Examination, truth: &CaseTruth<'_>) -> HostileRun {
    let own = |o: &&ihd_gate::MethodResult| o.method == run.method;
    for outcome in examined.outcomes.iter().filter(own) {
        let own_errors = errors(truth, outcome, &examined.segments);
        if outcome.result.is_ok() && own_errors.is_none() {
            // Without the middle of a half-cycle there is nothing to judge.
            continue;
        }
        run.stretches += 1;
        let findings = &outcome.judgement.findings;
        let mut warned = false;
        for finding in findings.iter().filter(|f| f.severity >= Severity::Warning) {
            warned = true;
            if !run.codes.iter().any(|code| code == finding.code) {
                run.codes.push(finding.code.to_owned());
            }
        }
        let refused = !outcome.judgement.gate.passes() || outcome.result.is_err();
        run.refused |= refused;
        let judged = ResultJudgement::judge(run.group, own_errors, refused, warned);
        run.judged = run.judged.max(judged);
        if !refused && !warned && judged != ResultJudgement::Invisible {
            let own = own_errors.and_then(|e| e.per_sigma);
            run.unremarked_per_sigma = larger(run.unremarked_per_sigma, own);
        }
        run.errors = match (run.errors, own_errors) {
            (Some(a), Some(b)) => Some(a.or_worse(b)),
            (a, b) => a.or(b),
        };
        match &outcome.result {
            Ok(estimate) => run.elapsed_s += estimate.elapsed.as_secs_f64(),
            Err(error) => run.why = Some(error.to_string()),
        }
        let first = outcome.judgement.gate.why.first();
        run.why = run.why.or_else(|| first.cloned());
    }
    if run.stretches == 0 {
        run.refused = true;
        run.judged = ResultJudgement::judge(run.group, None, true, false);
        run.why = Some("no stretch holds the middle of a half-cycle".to_owned());
    }
    run
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn plan(short: bool) -> HostilePlan {
        HostilePlan {
            methods: vec![Method::LeastSquares],
            seeds: 1,
            only: None,
            short,
        }
    }

    #[test]
    fn the_matrix_is_large_enough_and_every_case_can_be_simulated() {
        let cases = plan(false).cases();
        assert!(cases.len() >= 60, "{}", cases.len());
        let names: BTreeSet<_> = cases.iter().map(|c| &c.name).collect();
        assert_eq!(names.len(), cases.len());
        for case in &cases {
            assert_eq!(case.settings.check(), Ok(()), "{}", case.name);
        }
        let short = plan(true).cases();
        assert!((15..=30).contains(&short.len()), "{}", short.len());
        assert!(short.iter().any(|c| c.group == CaptureGroup::Clean));
    }

    /// The study counts a refusal of a clean capture as a defect, so none may clip.
    #[test]
    fn no_clean_capture_clips_at_length() {
        for case in plan(false).cases() {
            let s = &case.settings;
            if case.group != CaptureGroup::Clean
                || s.load == ihd_sim::recording::settings::LoadKind::Field
            {
                continue;
            }
            let r = record(s, |_| ()).unwrap();
            let most = (1u16 << (s.sensing.bits - 1)) - 1;
            let clips = |codes: &[i16]| codes.iter().any(|c| c.unsigned_abs() >= most);
            assert!(!clips(&r.v_code) && !clips(&r.i_code), "{}", case.name);
        }
    }

    #[test]
    fn a_user_has_waveforms_and_no_truth() {
        let cases = all();
        let recording = record(&cases[0].settings, |_| ()).unwrap();
        let capture = capture(&cases[0], &recording);
        assert!(capture.truth.is_empty() && capture.f_sw.is_empty());
        assert_eq!((capture.mains_hz, capture.v_full_scale_v), (None, None));
        assert_eq!(capture.len(), recording.v_code.len());
    }
}
