//! Figure of the study, for two pots: the error of R of every reached cell over its current, a line per frequency; below, the
//! errors of R and L over the deviations stated by the cells.

use std::path::Path;

use ihd_shared::lookup::grid::{FREQUENCIES, current_a, frequency_hz};
use ihd_train::lookup::JudgedCell;
use plotters::prelude::*;

use super::table::BUILDERS;
use super::{LookupJudgement, MapRun};
use ihd_plot::legend::header;
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, GREY, Pen, PlotCurve, PlotPanel, RED, span,
};
use ihd_plot::{FigureError, file};

/// Size of a panel in pixels.
const PANEL_PX: (u32, u32) = (520, 330);

/// Limit of pots in a figure.
const POTS: usize = 2;

/// Colours from the lowest to the highest frequency: viridis, suitable for the colour-blind.
const COLOURS: [RGBColor; FREQUENCIES] = [
    RGBColor(68, 1, 84),
    RGBColor(70, 50, 127),
    RGBColor(54, 92, 141),
    RGBColor(39, 127, 142),
    RGBColor(31, 161, 135),
    RGBColor(74, 194, 109),
    RGBColor(159, 218, 58),
    RGBColor(223, 190, 20),
];

/// Row of panels: builder of the lookups, and the lookup of each pot.
type Row<'a> = (&'static str, Vec<(&'a str, &'a LookupJudgement)>);

/// Draws the errors of the first seed of the first two pots; two rows per builder.
///
/// # Errors
/// If the file cannot be written.
pub fn draw(path: &Path, runs: &[MapRun]) -> Result<(), FigureError> {
    let rows = rows(runs);
    let columns = rows.iter().map(|r| r.1.len()).max().unwrap_or(0) as u32;
    let size = (
        PANEL_PX.0 * columns.max(1),
        PANEL_PX.1 * 2 * rows.len().max(1) as u32 + 60,
    );
    file::write(path, size, |root| drawing(root, columns, &rows))
}

fn rows(runs: &[MapRun]) -> Vec<Row<'_>> {
    let rows = BUILDERS.into_iter().map(|(builder, verdict)| {
        let judged = runs.iter().filter(|r| r.seed == 1);
        let judged = judged.filter_map(|r| Some((r.pot.as_str(), verdict(r)?)));
        let with_cells = judged.filter(|(_, v)| !v.cells.is_empty());
        (builder, with_cells.take(POTS).collect())
    });
    rows.filter(|(_, verdicts): &Row<'_>| !verdicts.is_empty())
        .collect()
}

fn drawing(root: &Area<'_>, columns: u32, rows: &[Row<'_>]) -> DrawResult {
    let all = rows.iter().flat_map(|r| &r.1).flat_map(|(_, v)| &v.cells);
    let named: Vec<plot::LegendEntry> = (0..FREQUENCIES)
        .filter(|f| all.clone().any(|c| c.frequency == *f))
        .map(|f| plot::LegendEntry::from_curve(&curve(f, &[])))
        .collect();
    let below = header(root, "Cells against the truth: dots are observed", &named)?;
    let areas = below.split_evenly((2 * rows.len().max(1), columns.max(1) as usize));
    for (n, (builder, verdicts)) in rows.iter().enumerate() {
        for (k, (pot, verdict)) in verdicts.iter().enumerate() {
            let area = |row: usize| &areas[(2 * n + row) * columns as usize + k];
            over_current(area(0), &format!("{pot}, by {builder}"), &verdict.cells)?;
            over_deviation(area(1), &verdict.cells)?;
        }
    }
    Ok(())
}

fn curve(frequency: usize, cells: &[&JudgedCell]) -> PlotCurve {
    let points = cells.iter().map(|c| (current_a(c.current), c.r_pct));
    let name = format!("{:.0} kHz", frequency_hz(frequency) * 1e-3);
    PlotCurve::new(&name, COLOURS[frequency], Pen::Line(2), points.collect())
}

fn over_current(area: &Area<'_>, title: &str, cells: &[JudgedCell]) -> DrawResult {
    let mut curves = Vec::new();
    for frequency in 0..FREQUENCIES {
        let own: Vec<&JudgedCell> = cells.iter().filter(|c| c.frequency == frequency).collect();
        let observed: Vec<&JudgedCell> = own.iter().copied().filter(|c| c.observed).collect();
        if own.is_empty() {
            continue;
        }
        curves.push(curve(frequency, &own));
        curves.push(PlotCurve {
            pen: Pen::Dots,
            ..curve(frequency, &observed)
        });
    }
    let (low, high) = span(cells.iter().map(|c| c.r_pct)).unwrap_or((-1.0, 1.0));
    let air = 0.08 * (high - low).max(0.5);
    let top_a = cells
        .iter()
        .map(|c| current_a(c.current))
        .fold(10.0, f64::max);
    let panel = PlotPanel {
        x: Axis::linear("current's amplitude / A", 0.0..top_a),
        y: Axis::linear("error of R / %", low.min(0.0) - air..high.max(0.0) + air),
    };
    let below = header(area, title, &[])?;
    plot::draw(&below, &panel, &curves)?;
    Ok(())
}

/// Smallest error drawn, in percent: smaller ones are drawn here, as the codes of a lookup resolve no more.
const MIN_PCT: f64 = 1e-2;

/// Panel of errors over their deviations: if these are correct, two of three dots lie below the line, and one of twenty above twice of it.
fn over_deviation(area: &Area<'_>, cells: &[JudgedCell]) -> DrawResult {
    let dots = |name: &str, colour, of: fn(&JudgedCell) -> (f64, f64)| {
        let points = cells.iter().map(of);
        let points = points.map(|(sigma, error)| (sigma.max(MIN_PCT), error.abs().max(MIN_PCT)));
        PlotCurve::new(name, colour, Pen::Dots, points.collect())
    };
    let mut curves = vec![
        dots("R", BLUE, |c| (c.r_sigma_pct, c.r_pct)),
        dots("L", RED, |c| (c.l_sigma_pct, c.l_pct)),
    ];
    let all = curves.iter().flat_map(PlotCurve::points);
    let largest = all.flat_map(|(x, y)| [x, y]).fold(1.0, f64::max);
    let range = MIN_PCT..1.5 * largest;
    let line = |name: &str, pen, times: f64| {
        let ends = [range.start, range.end / times].map(|x| (x, times * x));
        PlotCurve::new(name, GREY, pen, ends.to_vec())
    };
    curves.insert(0, line("error = σ", Pen::Line(2), 1.0));
    curves.insert(1, line("error = 2 σ", Pen::Broken(2), 2.0));
    let panel = PlotPanel {
        x: Axis::decades("stated deviation σ / %", range.clone()),
        y: Axis::decades("|error| / %", range),
    };
    let entries: Vec<_> = curves.iter().map(plot::LegendEntry::from_curve).collect();
    let below = header(area, "", &entries)?;
    plot::draw(&below, &panel, &curves)?;
    Ok(())
}
