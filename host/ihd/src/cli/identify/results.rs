//! Results of `ihd identify` on their way out: standard output, tables and figures, part by part.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context, Result, bail};
use ihd_gate::{Examination, VerdictTally};
use ihd_identify::Estimate;
use ihd_identify::pooled::{PoolPhasors, pool_phasors};
use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, Segment, Severity, atomic};

use super::super::capture_args::CaptureArgs;
use super::super::output::{self, JsonArray};
use super::page::ReportPage;
use super::report::{self, CsvTable, ReportedCapture};
use crate::report::identified;

/// Error for results that do not pass the gate, after they were printed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct RefusedResults(String);

/// Error that names the methods with results that may not be used, and the remedy; `None` if there are none.
fn refusal(
    tallies: &BTreeMap<&'static str, VerdictTally>,
) -> Option<(RefusedResults, &'static str)> {
    let unfit: Vec<String> = (tallies.iter())
        .filter(|(_, t)| t.unfit() > 0)
        .map(|(method, t)| {
            let verdict = if t.refused > 0 {
                "refused"
            } else {
                "cannot be judged"
            };
            match t.passed + t.refused + t.open {
                1 => format!("{method} {verdict}"),
                all => format!("{method} {verdict} in {} of {all} stretches", t.unfit()),
            }
        })
        .collect();
    let others = tallies.len() - unfit.len();
    let text = unfit.join(", ");
    let passing = match others {
        0 => String::new(),
        1 => "; the other passes".to_owned(),
        n => format!("; the other {n} pass"),
    };
    let remedy = match others {
        0 => "mend the capture as advised, or go on with --anyway",
        _ => "mend the capture as advised, leave those methods out, or go on with --anyway",
    };
    (!unfit.is_empty()).then(|| (RefusedResults(text + &passing), remedy))
}

/// Options of the output.
#[derive(Clone, Copy, Debug)]
pub struct ResultOptions<'a> {
    /// Files of the capture, and how they are read.
    pub capture: &'a CaptureArgs,
    /// JSON on standard output, else text.
    pub json: bool,
    /// `true` if several parts come.
    pub in_parts: bool,
    /// Time in seconds from which estimates are compared with the truth.
    pub from_s: f64,
    /// Files of tables.
    pub tables: &'a [&'a Path],
    /// Files of figures.
    pub figures: &'a [&'a Path],
    /// Files of reports.
    pub pages: &'a [&'a Path],
    /// `true` if a refused result is no error.
    pub anyway: bool,
}

/// Writer of the results of one capture.
pub struct ResultWriter<'a> {
    options: ResultOptions<'a>,
    /// JSON on standard output; `None` for text.
    json: Option<JsonArray>,
    tables: Vec<CsvTable>,
    figure: Option<Figure>,
    page: Option<ReportPage>,
    /// Parts that have a finding, by its code.
    found: BTreeMap<&'static str, usize>,
    parts: usize,
    calibration: String,
    /// Phasors of all parts; none of a capture of one part.
    phasors: Option<Vec<PoolPhasors>>,
    tallies: BTreeMap<&'static str, VerdictTally>,
}

impl<'a> ResultWriter<'a> {
    /// Creates a writer of nothing yet: files that are there stay until there is a result.
    pub fn new(options: ResultOptions<'a>) -> Self {
        let draws = !(options.figures.is_empty() && options.pages.is_empty());
        Self {
            options,
            json: options.json.then(JsonArray::default),
            tables: Vec::new(),
            figure: draws.then(Figure::default),
            page: (!options.pages.is_empty()).then(|| ReportPage::new(options.capture)),
            found: BTreeMap::new(),
            parts: 0,
            calibration: String::new(),
            phasors: options.in_parts.then(Vec::new),
            tallies: BTreeMap::new(),
        }
    }

    /// Writes the results of a part.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn take(&mut self, capture: Capture, mut examined: Examination) -> Result<()> {
        self.complain(&examined);
        let reported = ReportedCapture::new(&capture, &examined, self.options.from_s);
        if self.tables.is_empty() {
            let tables = self.options.tables.iter();
            self.tables = tables.map(|t| CsvTable::create(t)).collect::<Result<_>>()?;
        }
        for table in &mut self.tables {
            table.append(&examined.outcomes)?;
        }
        match &mut self.json {
            Some(array) => reported.json().iter().try_for_each(|e| array.push(e))?,
            None => output::text(&reported.text(self.phasors.is_some()))?,
        }
        if let Some(page) = &mut self.page {
            page.take(&reported, self.options.in_parts);
        }
        self.calibration = reported.calibration_text();
        if let Some(phasors) = &mut self.phasors {
            phasors.append(&mut examined.phasors);
        }
        for outcome in examined.outcomes.iter().filter(|o| o.result.is_ok()) {
            let tally = self.tallies.entry(outcome.method.name()).or_default();
            tally.count(outcome.judgement.gate.verdict);
        }
        if let Some(figure) = &mut self.figure {
            let found = examined.outcomes.drain(..).filter_map(|o| o.result.ok());
            figure.take(capture, std::mem::take(&mut examined.segments), found);
        }
        Ok(())
    }

    /// Prints what a user must know about the part; what an earlier part had is counted.
    fn complain(&mut self, examined: &Examination) {
        let mut of_part = BTreeSet::new();
        let mut new = |code, text: String| {
            of_part.insert(code);
            if !self.found.contains_key(code) {
                output::complain(format_args!("{text}"));
            }
        };
        for remark in examined.sensors_to_report() {
            new(remark.code, remark.to_string());
        }
        for finding in &examined.survey.findings {
            if finding.severity() > Severity::Info {
                new(finding.code(), format!("{}: {finding}", finding.severity()));
            }
        }
        for code in of_part {
            *self.found.entry(code).or_insert(0) += 1;
        }
        self.parts += 1;
    }

    /// Completes the output; `missing` is the reason why a part of the capture is not in it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(&mut self, missing: Option<String>) -> Result<()> {
        let again: Vec<String> = (self.found.iter())
            .filter(|(_, parts)| **parts > 1)
            .map(|(code, parts)| format!("{code} in {parts}"))
            .collect();
        if !again.is_empty() {
            let (parts, again) = (self.parts, again.join(", "));
            output::complain(format_args!("of {parts} parts of the capture: {again}"));
        }
        match &mut self.json {
            Some(array) => array.end()?,
            None => {
                let phasors = self.phasors.as_deref().unwrap_or_default();
                let alike = |a: &PoolPhasors, b: &PoolPhasors| {
                    (a.f_sw_hz() / b.f_sw_hz() - 1.0).abs() < ONE_FREQUENCY
                };
                for stretch in phasors.chunk_by(alike) {
                    output::text(&pooled_text(stretch))?;
                }
                output::text(&self.calibration)?;
            }
        }
        for table in std::mem::take(&mut self.tables) {
            table.complete()?;
        }
        if let (Some(page), Some(figure)) = (&mut self.page, &self.figure) {
            if let Some(missing) = missing {
                page.doubt_file(&missing);
            }
            let html = page.html(&self.calibration, &figure.zoomable());
            for path in self.options.pages {
                atomic::replace(path, html.as_bytes())
                    .with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        if let Some(figure) = &self.figure {
            for path in self.options.figures {
                figure.draw(path)?;
            }
        }
        Ok(())
    }

    /// Result of the command, after everything was written.
    ///
    /// # Errors
    /// If no method had a result, or if results are refused without `--anyway`.
    pub fn verdict(&self) -> Result<()> {
        if self.tallies.is_empty() {
            let capture = self.options.capture.path().display();
            bail!("no method could identify {capture}");
        }
        match refusal(&self.tallies) {
            Some((refused, remedy)) if !self.options.anyway => Err(refused).context(remedy),
            _ => Ok(()),
        }
    }
}

/// Relative difference of switching frequencies that costs less than .05 % of R, which grows with their root: pooled as one.
const ONE_FREQUENCY: f64 = 1e-3;

/// Law that the half-cycles of several stretches share; empty if there is none.
fn pooled_text(stretches: &[PoolPhasors]) -> String {
    let Some(phasors) = PoolPhasors::joined(stretches) else {
        return String::new();
    };
    let Some(law) = pool_phasors(&phasors) else {
        return String::new();
    };
    let (from_s, to_s) = phasors.span_s();
    format!(
        "pooled over the half-cycles from {:.2} to {:.2} ms, {:.3} kHz:\n{}",
        from_s * 1e3,
        to_s * 1e3,
        phasors.f_sw_hz() * 1e-3,
        report::pooled(&law)
    )
}

/// Contents of a figure: R and L of all parts, waveforms of the one with the longest segment.
#[derive(Default)]
struct Figure {
    name: String,
    estimates: Vec<Estimate>,
    truth: Vec<PeriodTruth>,
    /// Segments of the part with the longest one.
    segments: Vec<Segment>,
}

impl Figure {
    fn take(
        &mut self,
        capture: Capture,
        segments: Vec<Segment>,
        estimates: impl Iterator<Item = Estimate>,
    ) {
        let longest = |s: &[Segment]| s.iter().map(Segment::len).max().unwrap_or(0);
        let is_longest = longest(&segments) > longest(&self.segments);
        let without = |e: &mut Estimate| (e.v_hat_v, e.i_hat_a) = (Vec::new(), Vec::new());
        let mut estimates: Vec<Estimate> = estimates.collect();
        if is_longest {
            self.estimates.iter_mut().for_each(without);
            self.segments = segments;
        } else {
            estimates.iter_mut().for_each(without);
        }
        self.estimates.extend(estimates);
        self.truth.extend(capture.truth);
        self.name = capture.name;
    }

    fn zoomable(&self) -> String {
        let estimates: Vec<_> = self.estimates.iter().collect();
        identified::zoomable(&self.segments, &estimates, &self.truth)
    }

    fn draw(&self, path: &Path) -> Result<()> {
        let estimates: Vec<_> = self.estimates.iter().collect();
        let drawn = identified::draw(&self.name, &self.segments, &estimates, &self.truth, path);
        Ok(drawn?)
    }
}

#[cfg(test)]
mod tests {
    use ihd_gate::Verdict;

    use super::*;

    /// Two samples that are no numbers, 0.7 ms after the beginning, leave a stub beside 19.3 ms.
    #[test]
    fn a_stub_beside_a_stretch_that_passes_is_no_refusal() {
        let tallies = |of: &[(&'static str, Verdict)]| {
            let mut tallies: BTreeMap<&'static str, VerdictTally> = BTreeMap::new();
            for (method, verdict) in of {
                tallies.entry(method).or_default().count(*verdict);
            }
            refusal(&tallies).map(|(e, _)| e.to_string())
        };
        let (pass, open, refuse) = (Verdict::Pass, Verdict::CannotTell, Verdict::Refuse);
        assert_eq!(tallies(&[("rts", open), ("rts", pass)]), None);
        let said = |of: &[_]| tallies(of).unwrap_or_default();
        assert_eq!(said(&[("rts", open)]), "rts cannot be judged");
        assert_eq!(
            said(&[("rts", open), ("rts", refuse), ("rts", pass), ("kf", pass)]),
            "rts refused in 1 of 3 stretches; the other passes"
        );
    }
}
