//! Output of `ihd identify`: text, JSON, CSV.

use std::fmt::Write;
use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use ihd_gate::{Examination, Gate, HalfCycleVerdict, MethodResult};
use ihd_identify::accuracy::Accuracy;
use ihd_identify::pooled::PooledLaw;
use ihd_identify::{Estimate, Method};
use ihd_signal::atomic::Replacement;
use ihd_signal::{Capture, Remark, Severity, WithSigma};
use ihd_survey::calibration::METADATA_KEY;
use serde::Serialize;

use super::printed::{Printed, stretch, whole_half_cycles};
use crate::report::table::TextTable;

/// Results of a capture, with their errors if it has the truth.
pub struct ReportedCapture<'a> {
    /// Capture, its samples perhaps taken.
    pub capture: &'a Capture,
    /// Results.
    pub examined: &'a Examination,
    /// One entry per outcome.
    pub accuracy: Vec<Option<Accuracy>>,
}

/// Object of the JSON array.
#[derive(Serialize)]
pub struct ReportEntry<'a> {
    method: Method,
    f_sw_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    /// Numbers of the table.
    #[serde(flatten)]
    printed: Option<Printed>,
    t_s: &'a [f64],
    r_ohm: &'a [f64],
    l_h: &'a [f64],
    r_sigma_ohm: &'a [f64],
    l_sigma_h: &'a [f64],
    /// P/I_rms² in ohm.
    #[serde(skip_serializing_if = "<[f64]>::is_empty")]
    r_power_ohm: &'a [f64],
    #[serde(skip_serializing_if = "Option::is_none")]
    mre_r_pct: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mre_l_pct: Option<f64>,
    nmse_v_pct: Option<f64>,
    nmse_i_pct: Option<f64>,
    elapsed_s: f64,
    notes: &'a [String],
    /// Findings on the result, worst first.
    findings: &'a [Remark],
    /// Verdict of the gate.
    gate: &'a Gate,
    /// Verdicts by half-cycle.
    half_cycles: &'a [HalfCycleVerdict],
    /// One law R(I), L(I) from all half-cycles of the stretch, whatever the method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pooled: Option<Pooled<'a>>,
}

/// Law over the current's amplitude.
#[derive(Serialize)]
struct Pooled<'a> {
    i_a: &'a [f64],
    r_ohm: &'a [f64],
    l_h: &'a [f64],
    r_sigma_ohm: &'a [f64],
    l_sigma_h: &'a [f64],
    /// Squared residual over what noise leaves.
    chi2: f64,
}

impl<'a> From<&'a PooledLaw> for Pooled<'a> {
    fn from(law: &'a PooledLaw) -> Self {
        Self {
            i_a: &law.i_a,
            r_ohm: &law.r_ohm,
            l_h: &law.l_h,
            r_sigma_ohm: &law.r_sigma_ohm,
            l_sigma_h: &law.l_sigma_h,
            chi2: law.chi2,
        }
    }
}

impl<'a> ReportedCapture<'a> {
    /// Compares with the capture's truth from `from_s` seconds on.
    pub fn new(capture: &'a Capture, examined: &'a Examination, from_s: f64) -> Self {
        let accuracy = |o: &MethodResult| {
            let segment = examined.segments.get(o.segment)?;
            Accuracy::measure(o.result.as_ref().ok()?, segment, &capture.truth, from_s)
        };
        Self {
            capture,
            examined,
            accuracy: examined.outcomes.iter().map(accuracy).collect(),
        }
    }

    /// Outcomes as JSON; a failed method has an `error` and empty vectors.
    pub fn json(&self) -> Vec<ReportEntry<'a>> {
        let outcomes = self.examined.outcomes.iter().zip(&self.accuracy);
        outcomes.map(|(o, a)| self.entry(o, *a)).collect()
    }

    /// Returns `true` if the sensors were corrected by self-calibration.
    fn self_calibrated(&self) -> bool {
        let mut sensors = self.examined.sensors.iter();
        sensors.any(|remark| remark.code == "self_calibrated")
    }

    /// Pooled law of a segment.
    pub fn law(&self, segment: usize) -> Option<&'a PooledLaw> {
        self.examined.pooled.get(segment)?.as_ref()
    }

    fn entry(&self, o: &'a MethodResult, accuracy: Option<Accuracy>) -> ReportEntry<'a> {
        let estimate = o.result.as_ref().ok();
        let of = |values: fn(&Estimate) -> &Vec<f64>| found_slice(o, values);
        let segment = self.examined.segments.get(o.segment);
        ReportEntry {
            method: o.method,
            f_sw_hz: segment.map_or(0.0, |s| s.f_sw_hz),
            error: o.result.as_ref().err().map(ToString::to_string),
            printed: segment.and_then(|s| Printed::of(s, o, &self.examined.survey.mains)),
            t_s: of(|e| &e.t_s),
            r_ohm: of(|e| &e.r_ohm),
            l_h: of(|e| &e.l_h),
            r_sigma_ohm: of(|e| &e.r_sigma_ohm),
            l_sigma_h: of(|e| &e.l_sigma_h),
            r_power_ohm: of(|e| &e.r_power_ohm),
            mre_r_pct: accuracy.map(|a| a.whole.r_pct),
            mre_l_pct: accuracy.map(|a| a.whole.l_pct),
            nmse_v_pct: estimate.and_then(|e| e.nmse_v_pct),
            nmse_i_pct: estimate.and_then(|e| e.nmse_i_pct),
            elapsed_s: estimate.map_or(0.0, |e| e.elapsed.as_secs_f64()),
            notes: estimate.map_or(&[], |e| e.notes.as_slice()),
            findings: &o.judgement.findings,
            gate: &o.judgement.gate,
            half_cycles: &o.judgement.half_cycles,
            pooled: self.law(o.segment).map(Pooled::from),
        }
    }

    /// Outcomes as text: a table per stretch, then the findings on each result. Of a capture in parts the pooled law is that of all
    /// parts, and a half-cycle of which a cut left nothing to see is none.
    pub fn text(&self, in_parts: bool) -> String {
        let Examination {
            survey, segments, ..
        } = self.examined;
        let mut out = String::new();
        for (index, segment) in segments.iter().enumerate() {
            let outcomes = self.examined.outcomes.iter().zip(&self.accuracy);
            let outcomes: Vec<_> = outcomes.filter(|(o, _)| o.segment == index).collect();
            let first = outcomes.first().map(|(o, _)| *o);
            let whole = first.map_or(0, |o| whole_half_cycles(o, &survey.mains).len());
            let _ = writeln!(
                out,
                "{}: {:.3} kHz, {:.2} to {:.2} ms, {:.3} MS/s, mains {:.2} Hz ({}), means over {}",
                survey.name,
                segment.f_sw_hz * 1e-3,
                segment.t0_s * 1e3,
                segment.t_s(segment.len()) * 1e3,
                1e-6 / segment.dt_s,
                segment.mains_hz,
                survey.mains.hz_source,
                match whole {
                    0 => "all of it: no whole half-cycle".to_owned(),
                    1 => "one half-cycle".to_owned(),
                    n => format!("{n} half-cycles"),
                }
            );
            out.push_str(&stretch(segment, &outcomes, &survey.mains));
            for (outcome, _) in outcomes {
                findings_text(outcome, self.examined, in_parts, &mut out);
            }
            if let (Some(law), false) = (self.law(index), in_parts) {
                let _ = write!(
                    out,
                    "pooled over the stretch's half-cycles:\n{}",
                    pooled(law)
                );
            }
        }
        out
    }

    /// Line on the sensors' calibration; empty if it was reported already.
    pub fn calibration_text(&self) -> String {
        let calibration = self.capture.metadata.get(METADATA_KEY);
        match (calibration, self.examined.survey.skew_note()) {
            (Some(calibration), _) => format!("calibrated: {calibration}\n"),
            // The correction was reported instead.
            (None, Some(_)) if self.self_calibrated() => String::new(),
            (None, Some(note)) => format!("not calibrated: {note}\n"),
            (None, None) => String::new(),
        }
    }
}

/// A result's notes, its verdict, and findings that are not its reasons; those on the capture and its sensors were printed once for
/// all methods.
fn findings_text(outcome: &MethodResult, examined: &Examination, in_parts: bool, out: &mut String) {
    let method = outcome.method;
    match &outcome.result {
        Ok(estimate) => {
            for note in &estimate.notes {
                let _ = writeln!(out, "{method}: {note}");
            }
        }
        Err(error) => {
            let _ = writeln!(out, "{method} failed: {error}");
            return;
        }
    }
    for finding in outcome.judgement.doubts() {
        let of_survey = examined
            .survey
            .findings
            .iter()
            .any(|f| f.code() == finding.code);
        let of_sensors = examined.sensors.iter().any(|f| f.code == finding.code);
        if finding.severity == Severity::Warning && !of_survey && !of_sensors {
            let _ = writeln!(out, "{method}: {finding}");
        }
    }
    let _ = writeln!(out, "{method}: gate: {}", outcome.judgement.gate);
    let half_cycles = &outcome.judgement.half_cycles;
    let differs = |h: &&HalfCycleVerdict| h.gate.verdict != outcome.judgement.gate.verdict;
    let is_cut_off = |h: &&HalfCycleVerdict| in_parts && h.seen == 0.0;
    for half in half_cycles
        .iter()
        .filter(differs)
        .filter(|h| !is_cut_off(h))
    {
        let from_ms = half.from_s * 1e3;
        let _ = writeln!(
            out,
            "{method}: half-cycle from {from_ms:.2} ms: {}",
            half.gate
        );
    }
}

fn found_slice(outcome: &MethodResult, values: fn(&Estimate) -> &Vec<f64>) -> &[f64] {
    outcome
        .result
        .as_ref()
        .map_or(&[], |e| values(e).as_slice())
}

/// Table of estimates in a file: method, f_sw, time, R, L, their standard deviations and P/I_rms².
pub struct CsvTable {
    path: PathBuf,
    replacement: Replacement,
    writer: csv::Writer<File>,
}

impl CsvTable {
    /// Begins the file with its heading; it takes its name when it is [complete](CsvTable::complete).
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let cannot = || format!("cannot write {}", path.display());
        let (replacement, file) = Replacement::begin(path).with_context(cannot)?;
        let mut writer = csv::Writer::from_writer(file);
        let heading = [
            "method",
            "f_sw_hz",
            "t_s",
            "r_ohm",
            "l_h",
            "r_sigma_ohm",
            "l_sigma_h",
            "r_power_ohm",
        ];
        writer.write_record(heading).with_context(cannot)?;
        let path = path.to_owned();
        Ok(Self {
            path,
            replacement,
            writer,
        })
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn complete(mut self) -> Result<()> {
        let flushed = self.writer.flush();
        let done = flushed.and_then(|()| self.replacement.complete());
        done.with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Appends each estimate's points.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn append(&mut self, outcomes: &[MethodResult]) -> Result<()> {
        let cannot = || format!("cannot write {}", self.path.display());
        for estimate in outcomes.iter().filter_map(|o| o.result.as_ref().ok()) {
            for (k, (t, r, l)) in estimate.points().enumerate() {
                let number = |x: &[f64]| x.get(k).map_or(String::new(), |s| format!("{s:.6e}"));
                self.writer
                    .write_record([
                        estimate.method.name().to_owned(),
                        format!("{:.3}", estimate.f_sw_hz),
                        format!("{t:.9}"),
                        format!("{r:.9e}"),
                        format!("{l:.9e}"),
                        number(&estimate.r_sigma_ohm),
                        number(&estimate.l_sigma_h),
                        number(&estimate.r_power_ohm),
                    ])
                    .with_context(cannot)?;
            }
        }
        Ok(())
    }
}

/// Amplitudes in ampere at which the pooled law is printed.
const PRINTED_A: [f64; 9] = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0];

/// Table of a pooled law, up to the largest amplitude.
pub fn pooled(law: &PooledLaw) -> String {
    let (least_a, most_a) = match &law.i_a[..] {
        [least, .., most] => (*least, *most),
        _ => return String::new(),
    };
    let mut table = TextTable::new(&["I A, amplitude", "R Ω", "±", "L µH", "±"]);
    let inside = PRINTED_A.iter().filter(|a| (least_a..most_a).contains(*a));
    for i_a in inside.chain([&most_a]) {
        let [r, l] = law.at(*i_a);
        let [r, r_sigma] = WithSigma::new(r.0, r.1).texts();
        let [l, l_sigma] = WithSigma::new(l.0 * 1e6, l.1 * 1e6).texts();
        table.row(vec![format!("{i_a:.1}"), r, r_sigma, l, l_sigma]);
    }
    table.render()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An error between two parts of a capture ends the table.
    #[test]
    fn a_table_that_is_not_completed_leaves_the_older_one() {
        let folder = tempfile::tempdir().unwrap();
        let (older, new) = (folder.path().join("a.csv"), folder.path().join("b.csv"));
        std::fs::write(&older, "old").unwrap();
        drop(CsvTable::create(&older).unwrap());
        drop(CsvTable::create(&new).unwrap());
        assert_eq!(std::fs::read_to_string(&older).unwrap(), "old");
        assert!(!new.exists());
        CsvTable::create(&new).unwrap().complete().unwrap();
        let heading = std::fs::read_to_string(&new).unwrap();
        assert!(heading.starts_with("method,f_sw_hz,"), "{heading}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
