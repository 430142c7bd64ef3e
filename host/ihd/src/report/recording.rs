//! Figure of a recording, after the paper's Fig. 4 (waveforms) and Fig. 5 (R and L).

use std::ops::Range;
use std::path::Path;

use ihd_signal::truth::PeriodTruth;
use ihd_sim::recording::run::SimulatedRecording;

use ihd_plot::legend::header;
use ihd_plot::two_axes::{self, Side, Trace, Underlay, Zero};
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, LegendEntry, Pen, PlotCurve, PlotPanel, RED,
    envelope, span,
};
use ihd_plot::{FigureError, file};

/// Columns of a panel; each shows minimum and maximum.
const COLUMNS: usize = 420;

/// Switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 4.0;

/// Smallest current amplitude whose R and L are shown, in ampere.
pub const SMALLEST_A: f64 = 0.5;

/// Draws voltage and current over the whole recording and in a close-up at the largest current,
/// and R and L of the fundamental, to a file: SVG, PDF or PNG by its ending.
pub fn write(recording: &SimulatedRecording, path: &Path) -> Result<(), FigureError> {
    let peak = recording
        .truth
        .iter()
        .max_by(|a, b| a.i_a.total_cmp(&b.i_a));
    let peak = peak
        .filter(|t| t.i_a > SMALLEST_A)
        .ok_or(FigureError::Empty)?;
    file::write(path, (1100, 760), |root| draw(root, recording, peak))
}

fn draw(root: &Area<'_>, recording: &SimulatedRecording, peak: &PeriodTruth) -> DrawResult {
    let panels = root.split_evenly((2, 2));
    let all = 0..recording.t_s.len();
    waves(&panels[0], "Voltage and current", recording, all, peak)?;
    let half_s = 0.5 * CLOSE_UP_PERIODS / peak.f_sw_hz;
    let from = recording.t_s.partition_point(|t| *t < peak.t_s - half_s);
    let to = recording.t_s.partition_point(|t| *t < peak.t_s + half_s);
    let title = "At the largest current";
    waves(&panels[1], title, recording, from..to, peak)?;

    let loaded = || recording.truth.iter().filter(|t| t.i_a >= SMALLEST_A);
    let curve = |name: &str, colour, value: fn(&PeriodTruth) -> f64| {
        let points = loaded().map(|t| (t.t_s * 1e3, value(t)));
        PlotCurve::new(name, colour, Pen::Line(2), points.collect())
    };
    let r = [
        curve("of the fundamental", BLUE, |t| t.r_ohm[0]),
        curve("P / I²", RED, |t| t.r_power_ohm),
    ];
    let l = [
        curve("of the fundamental", BLUE, |t| t.l_h[0] * 1e6),
        curve("of the third harmonic", RED, |t| t.l_h[1] * 1e6),
    ];
    load(&panels[2], "Resistance", "R / Ω", &r)?;
    load(&panels[3], "Inductance", "L / µH", &l)
}

/// Voltage at the left axis, current at the right one.
fn waves(
    area: &Area<'_>,
    title: &str,
    recording: &SimulatedRecording,
    range: Range<usize>,
    peak: &PeriodTruth,
) -> DrawResult {
    let dense = range.len() > 2 * COLUMNS;
    let at = |k: usize| recording.t_s[k] * 1e3;
    let between = recording.t_s.get(1).zip(recording.t_s.first());
    let dt_s = between.map_or(f64::INFINITY, |(b, a)| b - a);
    let side = |label: &str, colour, value: &dyn Fn(usize) -> f64| {
        let trace = if dense {
            // In the close-up a period is far wider than a column, so single columns suffice.
            let period = 1.0 / (peak.f_sw_hz * dt_s);
            let many = range.len() as f64 / period > 2.0 * CLOSE_UP_PERIODS;
            let period = if many { period } else { 0.0 };
            Trace::Band(envelope::columns(range.clone(), COLUMNS, period, at, value))
        } else {
            Trace::Line(range.clone().map(|k| (at(k), value(k))).collect())
        };
        Side {
            label: label.into(),
            colour,
            trace,
        }
    };
    let v = |k: usize| f64::from(recording.v_code[k]) * recording.volt_per_code();
    let i = |k: usize| f64::from(recording.i_code[k]) * recording.ampere_per_code();
    let sides = [side("v / V", BLUE, &v), side("i / A", RED, &i)];
    let entries = [
        LegendEntry::line("voltage (left)", BLUE, Pen::Line(1)),
        LegendEntry::line("current (right)", RED, Pen::Line(1)),
    ];
    let below = header(area, title, &entries)?;
    two_axes::draw(&below, "t / ms", Zero::Middle, &sides, &Underlay::default())
}

/// R or L over time, from zero.
fn load(area: &Area<'_>, title: &str, label: &str, curves: &[PlotCurve]) -> DrawResult {
    let points = || curves.iter().flat_map(PlotCurve::points);
    let Some((from, to)) = span(points().map(|p| p.0)) else {
        return Ok(());
    };
    let (low, high) = span(points().map(|p| p.1)).unwrap_or((0.0, 1.0));
    let air = 0.05 * (high - low.min(0.0)).max(1e-9);
    let bottom = if low < 0.0 { low - air } else { 0.0 };
    let panel = PlotPanel {
        x: Axis::linear("t / ms", from..to),
        y: Axis::linear(label, bottom..high + air),
    };
    let entries: Vec<LegendEntry> = curves.iter().map(LegendEntry::from_curve).collect();
    let below = header(area, title, &entries)?;
    plot::draw(&below, &panel, curves)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

    use super::*;

    #[test]
    fn a_recording_becomes_a_small_svg_with_its_four_panels() {
        let s = CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s: 10e-3,
            ..CaptureSpec::default()
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.svg");
        write(&record(&s, |_| ()).unwrap(), &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for title in [
            // No axis is of a scaled quantity.
            "v / V",
            "i / A",
            "Voltage and current",
            "At the largest current",
            "Resistance",
            "Inductance",
        ] {
            assert!(svg.contains(title), "{title}");
        }
        assert!(svg.len() < 300_000, "{}", svg.len());
    }

    #[test]
    fn a_recording_without_current_has_no_figure() {
        let off = RecordingEvent {
            t_s: 0.0,
            change: RecordingChange::Off,
        };
        let s = CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            events: vec![off],
            ..CaptureSpec::default()
        };
        let path = Path::new("/nonexistent/a.svg");
        assert!(matches!(
            write(&record(&s, |_| ()).unwrap(), path),
            Err(FigureError::Empty)
        ));
    }
}
