//! Report of `ihd identify` as one page: what was captured, found and doubted, and the curves to zoom.

mod captured;
mod doubted;
mod html;

use std::fmt::Write;

use ihd_gate::{HalfCycleVerdict, MethodResult, Verdict};
use ihd_identify::Estimate;
use ihd_identify::accuracy::Accuracy;
use ihd_signal::Segment;
use ihd_survey::mains::{Mains, MainsSource};

use self::captured::CapturedFacts;
use self::doubted::DoubtList;
use self::html::{TableColumn, TableRow, page, table, text};
use super::super::capture_args::CaptureArgs;
use super::crest::{crest_of, squared_current};
use super::report::{self, ReportedCapture};

/// Columns of a stretch's table.
const COLUMNS: [TableColumn; 10] = [
    TableColumn::Text("Method"),
    TableColumn::Number("Half-cycle from ms"),
    TableColumn::Number("R Ω, mean"),
    TableColumn::Number("crest"),
    TableColumn::Number("± σ"),
    TableColumn::Number("L µH, mean"),
    TableColumn::Number("crest"),
    TableColumn::Number("± σ"),
    TableColumn::Text("Verdict"),
    TableColumn::Long("Cause"),
];

/// Sentence above the curves.
const HELP: &str = "<p class=\"screen\">Wheel: zoom (beside an axis, that axis alone). Drag: move. Double click: whole.</p>\n";

/// Report, gathered part by part.
pub struct ReportPage {
    captured: CapturedFacts,
    found: String,
    doubted: DoubtList,
    in_parts: bool,
}

impl ReportPage {
    /// Report of a capture that was not read yet.
    pub fn new(args: &CaptureArgs) -> Self {
        Self {
            captured: CapturedFacts::new(args),
            found: String::new(),
            doubted: DoubtList::default(),
            in_parts: false,
        }
    }

    /// Adds the results of a part.
    pub fn take(&mut self, reported: &ReportedCapture<'_>, in_parts: bool) {
        self.in_parts = in_parts;
        let examined = reported.examined;
        self.captured.take(reported.capture, examined);
        self.doubted.take(reported);
        for (index, segment) in examined.segments.iter().enumerate() {
            let _ = writeln!(
                self.found,
                "<h3>{:.3} kHz, {:.2} to {:.2} ms</h3>",
                segment.f_sw_hz * 1e-3,
                segment.t0_s * 1e3,
                segment.t_s(segment.len()) * 1e3
            );
            let outcomes = examined.outcomes.iter().zip(&reported.accuracy);
            let outcomes: Vec<_> = outcomes.filter(|(o, _)| o.segment == index).collect();
            let rows = outcomes
                .iter()
                .flat_map(|(o, _)| rows(segment, o, &examined.survey.mains, in_parts));
            self.found += &table(&COLUMNS, &rows.collect::<Vec<_>>());
            for (outcome, accuracy) in outcomes {
                self.found += &fit(outcome, *accuracy);
            }
            if let (Some(law), false) = (reported.law(index), in_parts) {
                let law = text(&report::pooled(law));
                let _ = writeln!(
                    self.found,
                    "<p>Pooled over the stretch's half-cycles:</p>\n<pre>{law}</pre>"
                );
            }
        }
    }

    /// Adds the reason why a part of the capture is missing.
    pub fn doubt_file(&mut self, missing: &str) {
        self.doubted.file(missing);
    }

    /// Whole page. `calibration` is the line on the sensors' calibration, `figure` the element of the curves.
    pub fn html(&mut self, calibration: &str, figure: &str) -> String {
        let mut body = format!(
            "<p>Written by ihd {}.</p>\n<h2>Captured</h2>\n{}<h2>Found</h2>\n{}",
            env!("CARGO_PKG_VERSION"),
            self.captured.html(calibration),
            self.found
        );
        body += "<h2>Doubted</h2>\n";
        body += &self.doubted.html(self.in_parts);
        body += "<h2>Curves</h2>\n";
        body += match figure {
            "" => "<p>None: no method gave an estimate.</p>\n",
            _ => HELP,
        };
        body += figure;
        let title = format!("R and L of {}", self.captured.files());
        page(&title, &body)
    }
}

/// Rows of a method's half-cycles; of a capture in parts without those of which a cut left nothing.
fn rows(segment: &Segment, outcome: &MethodResult, mains: &Mains, in_parts: bool) -> Vec<TableRow> {
    let Ok(estimate) = &outcome.result else {
        let cells = vec![outcome.method.name().into()];
        return vec![TableRow {
            class: "error",
            cells: [cells, vec!["–".into(); 7], vec!["failed".into()]].concat(),
        }];
    };
    let weights = squared_current(segment, &estimate.t_s);
    let half_cycles = outcome.judgement.half_cycles.iter();
    let seen = half_cycles.filter(|h| !(in_parts && h.seen == 0.0));
    let has_phase = mains.zero_crossing_source != MainsSource::Assumed;
    seen.map(|half| row(segment, estimate, half, &weights, has_phase))
        .collect()
}

fn row(
    segment: &Segment,
    estimate: &Estimate,
    half: &HalfCycleVerdict,
    weights: &[f64],
    has_phase: bool,
) -> TableRow {
    let crest = crest_of(segment, estimate, half.from_s).filter(|_| has_phase);
    let at = |x: &[f64], scale: f64| {
        let value = crest.and_then(|k| x.get(k)).filter(|x| x.is_finite());
        value.map_or("–".into(), |x| format!("{:.4}", x * scale))
    };
    let to_s = half.from_s + segment.half_cycle_s();
    let mean = |x: &[f64], scale: f64| {
        let inside = |t: f64| t >= half.from_s && t < to_s;
        let all = estimate.t_s.iter().zip(x).zip(weights);
        let points = all.filter(|((t, x), _)| inside(**t) && x.is_finite());
        let (sum, weight) = points.fold((0.0, 0.0), |(sum, weight), ((_, x), w)| {
            (sum + x * w, weight + w)
        });
        match weight > 0.0 {
            true => format!("{:.4}", sum / weight * scale),
            false => "–".into(),
        }
    };
    let (class, verdict) = match half.gate.verdict {
        Verdict::Pass => ("pass", "pass"),
        Verdict::Refuse => ("refuse", "refuse"),
        Verdict::CannotTell => ("cannot_tell", "cannot tell"),
    };
    TableRow {
        class,
        cells: vec![
            estimate.method.name().into(),
            format!("{:.2}", half.from_s * 1e3),
            mean(&estimate.r_ohm, 1.0),
            at(&estimate.r_ohm, 1.0),
            at(&estimate.r_sigma_ohm, 1.0),
            mean(&estimate.l_h, 1e6),
            at(&estimate.l_h, 1e6),
            at(&estimate.l_sigma_h, 1e6),
            verdict.into(),
            half.gate.why.join("; "),
        ],
    }
}

/// Verdict on a method's whole result, and how well it describes the stretch.
fn fit(outcome: &MethodResult, accuracy: Option<Accuracy>) -> String {
    let Ok(estimate) = &outcome.result else {
        return String::new();
    };
    let mut line = format!("{}: gate: {}.", outcome.method, outcome.judgement.gate);
    if let (Some(v), Some(i)) = (estimate.nmse_v_pct, estimate.nmse_i_pct) {
        let _ = write!(line, " NMSE of v {v:.3} %, of i {i:.3} %.");
    }
    if let Some(accuracy) = accuracy {
        let (r, l) = (accuracy.whole.r_pct, accuracy.whole.l_pct);
        let _ = write!(
            line,
            " Mean error against the truth: R {r:.3} %, L {l:.3} %."
        );
    }
    format!("<p>{}</p>\n", text(&line))
}
