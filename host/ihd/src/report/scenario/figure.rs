//! A scenario over time: power, frequency, crests, and what the firmware thought.

use std::path::Path;

use ihd_sim::scenario::record::{HalfCycle, Record};
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::report::FigureError;

const BLUE: RGBColor = RGBColor(31, 119, 180);
const RED: RGBColor = RGBColor(214, 39, 40);
const GREY: RGBColor = RGBColor(120, 120, 120);

type Panel<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A curve: its name, its colour, and its value in a half-cycle.
type Curve = (&'static str, RGBColor, fn(&HalfCycle) -> f64);

/// Draws a record to an SVG file.
///
/// # Errors
/// [`FigureError`] when there is no half-cycle or the file cannot be written.
pub fn write(record: &Record, path: &Path) -> Result<(), FigureError> {
    if record.half_cycles.is_empty() {
        return Err(FigureError::Empty);
    }
    let wrong = |e: String| FigureError::new(path, &e);
    let root = SVGBackend::new(path, (1000, 760)).into_drawing_area();
    root.fill(&WHITE).map_err(|e| wrong(e.to_string()))?;
    let (curves, bands) = root.split_vertically(600);
    let panels = curves.split_evenly((3, 1));
    let all: [(&str, &[Curve]); 3] = [
        (
            "Power / W",
            &[
                ("asked", GREY, |h| h.asked_w),
                ("true", BLUE, |h| h.power_w),
            ],
        ),
        ("f_sw / kHz", &[("f_sw", BLUE, |h| h.f_sw_hz * 1e-3)]),
        (
            "Crests: A, and V/10",
            &[
                ("i_peak / A", RED, |h| h.i_peak_a),
                ("v_coil / 10 V", BLUE, |h| h.v_coil_peak_v * 0.1),
            ],
        ),
    ];
    for (panel, (title, curves)) in panels.iter().zip(all) {
        chart(panel, title, record, curves).map_err(wrong)?;
    }
    draw_bands(&bands, record).map_err(wrong)?;
    root.present().map_err(|e| wrong(e.to_string()))
}

fn end_s(record: &Record) -> f64 {
    record.half_cycles.last().map_or(1.0, |h| h.t_s).max(1e-3)
}

fn chart(panel: &Panel<'_>, title: &str, record: &Record, curves: &[Curve]) -> Result<(), String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let values = || {
        let of = |(_, _, value): &Curve| record.half_cycles.iter().map(*value).fold(0.0, f64::max);
        curves.iter().map(of).fold(1.0, f64::max)
    };
    let mut chart = ChartBuilder::on(panel)
        .caption(title, ("sans-serif", 14))
        .margin_right(12)
        .x_label_area_size(18)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..end_s(record), 0.0..1.08 * values())
        .map_err(|e| text(&e))?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()
        .map_err(|e| text(&e))?;
    for &(name, colour, value) in curves {
        let points = record.half_cycles.iter().map(|h| (h.t_s, value(h)));
        chart
            .draw_series(LineSeries::new(points, &colour))
            .map_err(|e| text(&e))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    for fault in &record.faults {
        let line = [(fault.t_s, 0.0), (fault.t_s, 1.08 * values())];
        chart
            .draw_series(LineSeries::new(line, RED.mix(0.5)))
            .map_err(|e| text(&e))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.85))
        .draw()
        .map_err(|e| text(&e))
}

/// Three bands with names in them: state, pot, fault.
fn draw_bands(area: &Panel<'_>, record: &Record) -> Result<(), String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let mut chart = ChartBuilder::on(area)
        .margin_right(12)
        .x_label_area_size(30)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..end_s(record), 0.0..3.0)
        .map_err(|e| text(&e))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .y_labels(0)
        .x_desc("t / s")
        .draw()
        .map_err(|e| text(&e))?;
    let rows: [fn(&HalfCycle) -> &str; 3] = [|h| &h.fault, |h| &h.pot, |h| &h.state];
    for (row, name) in rows.into_iter().enumerate() {
        let y = row as f64;
        for stretch in record.half_cycles.chunk_by(|a, b| name(a) == name(b)) {
            let (from_s, word) = (stretch[0].t_s, name(&stretch[0]));
            let share = stretch.len() as f64 / record.half_cycles.len() as f64;
            let to_s = from_s + share * end_s(record);
            let fill = shade(word);
            let corners = [(from_s, y + 0.08), (to_s, y + 0.92)];
            chart
                .draw_series([Rectangle::new(corners, fill.filled())])
                .map_err(|e| text(&e))?;
            // A word needs room.
            if share > 0.012 * word.len() as f64 {
                let at = (from_s + 0.004 * end_s(record), y + 0.68);
                chart
                    .draw_series([Text::new(word.to_owned(), at, ("sans-serif", 12))])
                    .map_err(|e| text(&e))?;
            }
        }
    }
    for (row, title) in ["fault", "pot", "state"].into_iter().enumerate() {
        let (_, y) = chart.backend_coord(&(0.0, row as f64 + 0.65));
        let style = ("sans-serif", 12).into_text_style(area);
        area.draw_text(title, &style, (4, y - area.get_pixel_range().1.start))
            .map_err(|e| text(&e))?;
    }
    Ok(())
}

/// The same word has the same colour in every figure.
fn shade(word: &str) -> RGBColor {
    match word {
        "None" | "Idle" | "Unknown" => RGBColor(235, 235, 235),
        "Heating" | "Ferromagnetic" => RGBColor(178, 223, 178),
        "Probing" | "Small" => RGBColor(253, 224, 160),
        "Absent" | "Unsuitable" | "Waiting" => RGBColor(198, 210, 240),
        _ => RGBColor(246, 178, 178),
    }
}
