//! A figure of a recording, after the paper's Fig. 4 (waveforms) and Fig. 5 (R and L).

use std::ops::Range;
use std::path::Path;

use ihd_sim::recording::run::Recording;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::FigureError;

/// Columns of the overview; each shows its minimum and maximum.
const COLUMNS: usize = 600;

/// Switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 4.0;

/// Smallest current amplitude whose R and L are drawn, in ampere.
const SMALLEST_A: f64 = 0.5;

const VOLTAGE: RGBColor = RGBColor(31, 119, 180);
const CURRENT: RGBColor = RGBColor(214, 39, 40);

type Panel<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// One curve with its name and colour.
struct Curve<'a> {
    name: &'a str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

/// Draws voltage and current over the whole recording and in a close-up at the largest current,
/// and R and L of the fundamental, to an SVG file.
pub fn write(recording: &Recording, path: &Path) -> Result<(), FigureError> {
    let peak = recording
        .truth
        .iter()
        .max_by(|a, b| a.i_a.total_cmp(&b.i_a));
    let peak = peak
        .filter(|t| t.i_a > SMALLEST_A)
        .ok_or(FigureError::Empty)?;
    let wrong = |e: String| FigureError::new(path, &e);
    let root = SVGBackend::new(path, (1100, 720)).into_drawing_area();
    root.fill(&WHITE).map_err(|e| wrong(e.to_string()))?;
    let panels = root.split_evenly((2, 2));

    let v: Vec<f64> = recording
        .v_code
        .iter()
        .map(|c| f64::from(*c) * recording.volt_per_code())
        .collect();
    let i: Vec<f64> = recording
        .i_code
        .iter()
        .map(|c| f64::from(*c) * recording.ampere_per_code())
        .collect();
    let t_ms: Vec<f64> = recording.t_s.iter().map(|t| t * 1e3).collect();
    let waves = |range: Range<usize>| {
        [
            Curve {
                name: "v / 5 V",
                colour: VOLTAGE,
                points: extremes(|k| t_ms[k], |k| 0.2 * v[k], range.clone()),
            },
            Curve {
                name: "i / A",
                colour: CURRENT,
                points: extremes(|k| t_ms[k], |k| i[k], range),
            },
        ]
    };
    panel(&panels[0], "Voltage and current", &waves(0..t_ms.len())).map_err(wrong)?;
    let half_s = 0.5 * CLOSE_UP_PERIODS / peak.f_sw_hz;
    let from = recording.t_s.partition_point(|t| *t < peak.t_s - half_s);
    let to = recording.t_s.partition_point(|t| *t < peak.t_s + half_s);
    panel(
        &panels[1],
        "Close-up at the largest current",
        &waves(from..to),
    )
    .map_err(wrong)?;

    let loaded: Vec<_> = recording
        .truth
        .iter()
        .filter(|t| t.i_a >= SMALLEST_A)
        .collect();
    let of = |value: fn(&ihd_signal::truth::PeriodTruth) -> f64| {
        loaded.iter().map(|t| (t.t_s * 1e3, value(t))).collect()
    };
    let r = [
        Curve {
            name: "R of the fundamental / ohm",
            colour: VOLTAGE,
            points: of(|t| t.r_ohm[0]),
        },
        Curve {
            name: "P / I² / ohm",
            colour: CURRENT,
            points: of(|t| t.r_power_ohm),
        },
    ];
    let l = [
        Curve {
            name: "L of the fundamental / µH",
            colour: VOLTAGE,
            points: of(|t| t.l_h[0] * 1e6),
        },
        Curve {
            name: "L of the third harmonic / µH",
            colour: CURRENT,
            points: of(|t| t.l_h[1] * 1e6),
        },
    ];
    panel(&panels[2], "Resistance", &r).map_err(wrong)?;
    panel(&panels[3], "Inductance", &l).map_err(wrong)?;
    root.present().map_err(|e| wrong(e.to_string()))
}

/// Minimum and maximum of each column in their order of time, so that a carrier becomes a band.
pub(crate) fn extremes(
    t: impl Fn(usize) -> f64,
    x: impl Fn(usize) -> f64,
    range: Range<usize>,
) -> Vec<(f64, f64)> {
    let per_column = range.len().div_ceil(COLUMNS).max(1);
    let mut points = Vec::with_capacity(2 * COLUMNS);
    let mut start = range.start;
    while start < range.end {
        let end = (start + per_column).min(range.end);
        let by_value = |a: &usize, b: &usize| x(*a).total_cmp(&x(*b));
        let lowest = (start..end).min_by(by_value).unwrap_or(start);
        let highest = (start..end).max_by(by_value).unwrap_or(start);
        for k in [lowest.min(highest), lowest.max(highest)] {
            points.push((t(k), x(k)));
        }
        start = end;
    }
    points
}

fn panel(area: &Panel<'_>, title: &str, curves: &[Curve<'_>]) -> Result<(), String> {
    let all = || {
        curves
            .iter()
            .flat_map(|c| c.points.iter().copied())
            .filter(|p| p.1.is_finite())
    };
    let low = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
    let high = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NEG_INFINITY, f64::max);
    let x = low(&mut all().map(|p| p.0))..high(&mut all().map(|p| p.0));
    let (bottom, top) = (low(&mut all().map(|p| p.1)), high(&mut all().map(|p| p.1)));
    // Waveforms fill their panel: room for the legend above. R and L leave it below.
    let margin = 0.05 * (top - bottom).max(1e-9);
    let (bottom, top, legend) = if bottom < 0.0 {
        let room = 5.0 * margin;
        (bottom - margin, top + room, SeriesLabelPosition::UpperRight)
    } else {
        (0.0, top + margin, SeriesLabelPosition::LowerMiddle)
    };
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(44)
        .build_cartesian_2d(x, bottom..top)
        .map_err(|e| e.to_string())?;
    mesh(&mut chart).map_err(|e| e.to_string())?;
    for curve in curves {
        let (points, colour) = (
            curve.points.iter().copied().filter(|p| p.1.is_finite()),
            curve.colour,
        );
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(1)))
            .map_err(|e| e.to_string())?
            .label(curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(legend)
        .background_style(WHITE.mix(0.85))
        .draw()
        .map_err(|e| e.to_string())
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn mesh(chart: &mut Chart<'_, '_>) -> Result<(), impl std::error::Error> {
    chart
        .configure_mesh()
        .x_desc("t / ms")
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()
}

#[cfg(test)]
mod tests {
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::settings::{Change, Event, LoadKind, Settings};

    use super::*;

    #[test]
    fn a_recording_becomes_a_small_svg_with_its_four_panels() {
        let s = Settings {
            load: LoadKind::Behavioural,
            duration_s: 10e-3,
            ..Settings::default()
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.svg");
        write(&record(&s, |_| ()).unwrap(), &path).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for title in [
            "Voltage and current",
            "Close-up",
            "Resistance",
            "Inductance",
        ] {
            assert!(svg.contains(title), "{title}");
        }
        assert!(svg.len() < 300_000, "{}", svg.len());
    }

    #[test]
    fn a_recording_without_current_has_no_figure() {
        let off = Event {
            t_s: 0.0,
            change: Change::Off,
        };
        let s = Settings {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            events: vec![off],
            ..Settings::default()
        };
        let path = Path::new("/nonexistent/a.svg");
        assert!(matches!(
            write(&record(&s, |_| ()).unwrap(), path),
            Err(FigureError::Empty)
        ));
    }
}
