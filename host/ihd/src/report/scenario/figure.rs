//! Figure of a scenario over time: power, frequency, crests, and the firmware's states.

use std::path::Path;

use ihd_sim::scenario::record::{Record, TrueHalfCycle};
use plotters::prelude::*;

use ihd_plot::legend::header;
use ihd_plot::two_axes::{self, Side, Trace, Underlay, Zero};
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, RED,
    span,
};
use ihd_plot::{FigureError, file};

/// Width of the crests' right axis, left free in the other panels, so that their times are aligned.
const RIGHT_AXIS_PX: i32 = 54;

/// Draws a record to a file: SVG, PDF or PNG by its ending.
///
/// # Errors
/// [`FigureError`] if there is no half-cycle or the file cannot be written.
pub fn write(record: &Record, path: &Path) -> Result<(), FigureError> {
    if record.half_cycles.is_empty() {
        return Err(FigureError::Empty);
    }
    file::write(path, (1000, 860), |root| draw(root, record))
}

fn draw(root: &Area<'_>, record: &Record) -> DrawResult {
    let (curves, bands) = root.split_vertically(690);
    let panels = curves.split_evenly((3, 1));
    let curve = |name: &str, colour, value: fn(&TrueHalfCycle) -> f64| {
        let points = record.half_cycles.iter().map(|h| (h.t_s, value(h)));
        PlotCurve::new(name, colour, Pen::Line(1), points.collect())
    };
    let power = [
        curve("asked", GREY, |h| h.asked_w),
        curve("true", BLUE, |h| h.power_w),
    ];
    chart(&panels[0], "Power", "P / W", record, &power)?;
    let f_sw = [curve("", BLUE, |h| h.f_sw_hz * 1e-3)];
    chart(
        &panels[1],
        "Switching frequency",
        "f_sw / kHz",
        record,
        &f_sw,
    )?;
    crests(&panels[2], record)?;
    draw_bands(&bands.margin(0, 0, 0, RIGHT_AXIS_PX), record).map_err(|why| why.into())
}

fn end_s(record: &Record) -> f64 {
    record.half_cycles.last().map_or(1.0, |h| h.t_s).max(1e-3)
}

/// Legend entry of faults; `None` if there are none.
fn alarm(record: &Record) -> Option<LegendEntry> {
    let fault = LegendEntry::line("fault", RED, Pen::Line(1));
    (!record.faults.is_empty()).then_some(fault)
}

fn chart(
    area: &Area<'_>,
    title: &str,
    label: &str,
    record: &Record,
    curves: &[PlotCurve],
) -> DrawResult {
    let values = curves.iter().flat_map(PlotCurve::points).map(|p| p.1);
    // Power that rings back into the supply is slightly negative.
    let (low, high) = span(values).unwrap_or((0.0, 1.0));
    let (bottom, top) = (1.08 * low.min(0.0), 1.08 * high.max(1.0));
    let panel = PlotPanel {
        x: Axis::linear("", 0.0..end_s(record)),
        y: Axis::linear(label, bottom..top),
    };
    let named = curves.iter().filter(|c| !c.name.is_empty());
    let mut entries: Vec<LegendEntry> = named.map(LegendEntry::from_curve).collect();
    entries.extend(alarm(record));
    // Under the curves.
    let alarms = record
        .faults
        .iter()
        .map(|fault| vec![(fault.t_s, bottom), (fault.t_s, top)]);
    let mut all = vec![PlotCurve {
        name: String::new(),
        colour: RGBColor(235, 150, 150),
        pen: Pen::Line(1),
        runs: alarms.collect(),
    }];
    all.extend_from_slice(curves);
    let below = header(area, title, &entries)?;
    plot::draw(&below.margin(0, 0, 0, RIGHT_AXIS_PX), &panel, &all)?;
    Ok(())
}

/// Largest current at the left axis, the coil's largest voltage at the right one.
fn crests(area: &Area<'_>, record: &Record) -> DrawResult {
    let side = |label: &str, colour, value: fn(&TrueHalfCycle) -> f64| Side {
        label: label.into(),
        colour,
        trace: Trace::Line(
            record
                .half_cycles
                .iter()
                .map(|h| (h.t_s, value(h)))
                .collect(),
        ),
    };
    let sides = [
        side("i / A", RED, |h| h.i_peak_a),
        side("v / V", BLUE, |h| h.v_coil_peak_v),
    ];
    let entries = [
        LegendEntry::line("current (left)", RED, Pen::Line(1)),
        LegendEntry::line("coil voltage (right)", BLUE, Pen::Line(1)),
    ];
    let under = Underlay {
        alarms: record.faults.iter().map(|fault| fault.t_s).collect(),
        ..Underlay::default()
    };
    let below = header(area, "Largest of each half-cycle", &entries)?;
    two_axes::draw(&below, "", Zero::Bottom, &sides, &under)
}

/// Three bands with names in them: state, pot, fault.
fn draw_bands(area: &Area<'_>, record: &Record) -> Result<(), String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .margin_right(16)
        .x_label_area_size(40)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..end_s(record), 0.0..3.0)
        .map_err(|e| text(&e))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .y_labels(0)
        .x_labels(9)
        .x_desc("t / s")
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .draw()
        .map_err(|e| text(&e))?;
    let rows: [fn(&TrueHalfCycle) -> &str; 3] = [|h| &h.fault, |h| &h.pot, |h| &h.state];
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
            // A text needs room.
            if share > 0.013 * word.len() as f64 {
                let at = (from_s + 0.004 * end_s(record), y + 0.68);
                chart
                    .draw_series([Text::new(word.to_owned(), at, ("sans-serif", 14))])
                    .map_err(|e| text(&e))?;
            }
        }
    }
    for (row, title) in ["fault", "pot", "state"].into_iter().enumerate() {
        let (_, y) = chart.backend_coord(&(0.0, row as f64 + 0.65));
        let style = ("sans-serif", 14).into_text_style(area);
        area.draw_text(title, &style, (4, y - area.get_pixel_range().1.start))
            .map_err(|e| text(&e))?;
    }
    Ok(())
}

/// Colour of a text, the same in every figure.
fn shade(word: &str) -> RGBColor {
    match word {
        "None" | "Idle" | "Unknown" => RGBColor(235, 235, 235),
        "Heating" | "Ferromagnetic" => RGBColor(178, 223, 178),
        "Probing" | "Pausing" | "Small" => RGBColor(253, 224, 160),
        "Absent" | "Unsuitable" | "WaitingForPot" => RGBColor(198, 210, 240),
        _ => RGBColor(246, 178, 178),
    }
}
