//! Identification: `ihd_gate::examine` on a capture, as `ihd identify` calls it.

use ihd_gate::{
    ExamineOptions, Judgement, MethodResult, Reconstruct, Verdict, VerdictTally, examine_taking,
};
use ihd_identify::pooled::PooledLaw;
use ihd_identify::{Estimate, IdentifyOptions, Method};
use ihd_signal::{Remark, Segment, Severity};
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};
use ihd_survey::{Hints, StatedRange};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::capture::Capture;
use crate::errors::{IdentifyError, in_range, value};
use crate::interrupt::interruptible;

type Doubles = Py<PyArray1<f64>>;

/// A remark as a tuple: code, severity, text, value, limit.
type RemarkTuple = (&'static str, String, String, Option<f64>, Option<f64>);

/// A law as a tuple: amplitude of the current's fundamental in ampere, R, L, their standard deviations, squared residual over what
/// noise leaves.
type LawTuple = (Doubles, Doubles, Doubles, Doubles, Doubles, f64);

/// Result of a method on a stretch of constant switching frequency.
#[pyclass(frozen, get_all, module = "ihd._native")]
pub struct Outcome {
    /// Name of the method.
    method: &'static str,
    /// Switching frequency in hertz.
    f_sw: f64,
    /// Reason of a failure; `None` where there is an estimate.
    error: Option<String>,
    /// Time in seconds.
    t: Doubles,
    /// Resistance in ohm.
    #[pyo3(name = "R")]
    r: Doubles,
    /// Inductance in henry.
    #[pyo3(name = "L")]
    l: Doubles,
    /// Standard deviation of R in ohm; empty if the method states none.
    #[pyo3(name = "sigma_R")]
    sigma_r: Doubles,
    /// Standard deviation of L in henry; empty if the method states none.
    #[pyo3(name = "sigma_L")]
    sigma_l: Doubles,
    /// P/I_rms² over all harmonics in ohm; empty if the method does not separate them.
    #[pyo3(name = "R_power")]
    r_power: Doubles,
    /// Errors of the reconstructed voltage and current in percent.
    nmse: (Option<f64>, Option<f64>),
    /// Verdict of the gate.
    verdict: &'static str,
    /// Reasons of a verdict other than pass.
    why: Vec<String>,
    /// Findings, worst first.
    findings: Vec<RemarkTuple>,
    /// Verdicts by half-cycle: zero crossing in seconds, share seen, verdict, reasons.
    half_cycles: Vec<(f64, f64, &'static str, Vec<String>)>,
    /// Limits that the method reached, parts that failed.
    notes: Vec<String>,
    /// One law of all half-cycles of the stretch, whatever the method; `None` where there is none.
    law: Option<LawTuple>,
}

/// Name of a verdict, as in the program's JSON.
fn verdict_name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "pass",
        Verdict::Refuse => "refuse",
        Verdict::CannotTell => "cannot_tell",
    }
}

fn tuple(remark: Remark) -> RemarkTuple {
    let Remark {
        code,
        severity,
        text,
        value,
        limit,
    } = remark;
    (code, severity.to_string(), text, value, limit)
}

fn law_tuple(py: Python<'_>, law: &PooledLaw) -> LawTuple {
    let array = |x: &[f64]| PyArray1::from_slice(py, x).unbind();
    (
        array(&law.i_a),
        array(&law.r_ohm),
        array(&law.l_h),
        array(&law.r_sigma_ohm),
        array(&law.l_sigma_h),
        law.chi2,
    )
}

impl Outcome {
    fn new(
        py: Python<'_>,
        result: MethodResult,
        segments: &[Segment],
        laws: &[Option<PooledLaw>],
    ) -> Self {
        let law = laws.get(result.segment).and_then(Option::as_ref);
        let law = law.map(|law| law_tuple(py, law));
        let (estimate, error) = match result.result {
            Ok(estimate) => (Some(estimate), None),
            Err(error) => (None, Some(error.to_string())),
        };
        // As the program's JSON: the stretch's, which the method does not change.
        let f_sw = segments.get(result.segment).map_or(0.0, |s| s.f_sw_hz);
        let Estimate {
            t_s,
            r_ohm,
            l_h,
            r_sigma_ohm,
            l_sigma_h,
            r_power_ohm,
            nmse_v_pct,
            nmse_i_pct,
            notes,
            ..
        } = estimate.unwrap_or_else(|| Estimate::new(result.method, f_sw));
        let Judgement {
            findings,
            gate,
            half_cycles,
        } = result.judgement;
        let half_cycles = half_cycles.into_iter();
        let array = |x: Vec<f64>| PyArray1::from_vec(py, x).unbind();
        Self {
            method: result.method.name(),
            f_sw,
            error,
            t: array(t_s),
            r: array(r_ohm),
            l: array(l_h),
            sigma_r: array(r_sigma_ohm),
            sigma_l: array(l_sigma_h),
            r_power: array(r_power_ohm),
            nmse: (nmse_v_pct, nmse_i_pct),
            verdict: verdict_name(gate.verdict),
            why: gate.why,
            findings: findings.into_iter().map(tuple).collect(),
            half_cycles: half_cycles
                .map(|h| (h.from_s, h.seen, verdict_name(h.gate.verdict), h.gate.why))
                .collect(),
            notes,
            law,
        }
    }
}

/// Verdict on the estimates of several stretches together, by their names; `None` without one.
#[pyfunction]
pub fn overall_verdict(verdicts: Vec<String>) -> Option<&'static str> {
    let mut tally = VerdictTally::default();
    for name in verdicts {
        let all = [Verdict::Pass, Verdict::Refuse, Verdict::CannotTell];
        let named = all.into_iter().find(|v| verdict_name(*v) == name);
        tally.count(named.unwrap_or(Verdict::Refuse));
    }
    tally.verdict().map(verdict_name)
}

/// Names of all methods.
#[pyfunction]
pub fn methods() -> Vec<&'static str> {
    Method::ALL.map(Method::name).to_vec()
}

/// Identifies every stretch of a capture by every method; returns the outcomes, and remarks on capture and sensors.
///
/// `settings` is JSON of the estimators' settings.
#[pyfunction]
#[pyo3(signature = (capture, methods, settings, *, f_sw=None, f_mains=None, zero_crossing=None, self_calibrate="auto", capacitance=None))]
#[expect(clippy::too_many_arguments, reason = "one for each option")]
pub fn identify(
    py: Python<'_>,
    capture: &Bound<'_, Capture>,
    methods: Vec<String>,
    settings: &str,
    f_sw: Option<f64>,
    f_mains: Option<f64>,
    zero_crossing: Option<f64>,
    self_calibrate: &str,
    capacitance: Option<f64>,
) -> PyResult<(Vec<Outcome>, Vec<RemarkTuple>)> {
    let methods = chosen(&methods)?;
    let settings: IdentifyOptions = serde_json::from_str(settings).map_err(value)?;
    settings.check_start().map_err(value)?;
    settings.pinn.check().map_err(value)?;
    let hints = Hints {
        f_sw_hz: stated("f_sw", f_sw, StatedRange::SwitchingHz)?,
        mains_hz: stated("f_mains", f_mains, StatedRange::MainsHz)?,
        zero_crossing_s: stated("zero_crossing", zero_crossing, StatedRange::TimeS)?,
        ..capture.get().wiring()
    };
    let sensors = BlindOptions {
        mode: mode(self_calibrate)?,
        capacitance_f: stated("capacitance", capacitance, StatedRange::CapacitanceF)?,
    };
    let mut samples = capture.get().to_signal(py)?;
    let examined = interruptible(py, |look| {
        let request = ExamineOptions {
            hints,
            methods: &methods,
            sensors,
            settings: &settings,
            reconstruct: Reconstruct::Errors,
        };
        examine_taking(&mut samples, &request, &mut |_, _, _| look())
    })?;
    let failed = |error: ihd_survey::SurveyError| IdentifyError::new_err(error.to_string());
    let examined = examined.map_err(failed)?;
    // Those that the program prints.
    let sensors = examined.sensors_to_report().cloned();
    let survey = examined.survey.findings.iter().map(|f| f.remark());
    let survey = survey.filter(|remark| remark.severity > Severity::Info);
    let remarks = sensors.chain(survey).map(tuple).collect();
    let outcomes = examined.outcomes.into_iter();
    let (segments, laws) = (&examined.segments, &examined.pooled);
    let outcomes = outcomes.map(|result| Outcome::new(py, result, segments, laws));
    Ok((outcomes.collect(), remarks))
}

fn stated(name: &str, x: Option<f64>, range: StatedRange) -> PyResult<Option<f64>> {
    x.map(|x| in_range(name, x, range)).transpose()
}

fn chosen(names: &[String]) -> PyResult<Vec<Method>> {
    let method = |name: &String| {
        let found = Method::ALL.into_iter().find(|m| m.name() == name);
        found.ok_or_else(|| {
            let all = Method::ALL.map(Method::name).join(", ");
            value(format!("method {name:?} is unknown: use {all}"))
        })
    };
    names.iter().map(method).collect()
}

fn mode(word: &str) -> PyResult<CalibrationMode> {
    match word {
        "auto" => Ok(CalibrationMode::Auto),
        "report" => Ok(CalibrationMode::Report),
        "off" => Ok(CalibrationMode::Off),
        _ => Err(value(format!(
            "self_calibrate={word:?}: must be \"auto\", \"report\" or \"off\""
        ))),
    }
}
