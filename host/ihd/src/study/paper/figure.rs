//! The study's figures: R(t) and L(t) against the truth (the paper's Figs. 5 and 6), and loss curves.

use std::ops::Range;
use std::path::Path;

use ihd_sim::recording::settings::LoadKind;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::{Cell, Contender};
use crate::report::FigureError;

type Drawn = Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A named curve in the figure's units.
struct Curve {
    name: String,
    points: Vec<(f64, f64)>,
    style: Style,
}

/// How a curve is drawn.
#[derive(Clone, Copy)]
enum Style {
    /// What the others are held against: wide and grey.
    Reference,
    /// In the colour of the contender with this number.
    Solid(usize),
    /// The same, broken.
    Broken(usize),
}

/// Draws all figures of the first seed into `folder`; returns their names.
pub fn all(cells: &[Cell], folder: &Path) -> Result<Vec<String>, FigureError> {
    let mut names = Vec::new();
    let mut groups: Vec<Vec<&Cell>> = Vec::new();
    for cell in cells {
        match groups.iter().position(|group| same_point(group[0], cell)) {
            Some(at) if groups[at][0].job.seed == cell.job.seed => groups[at].push(cell),
            Some(_) => {}
            None => groups.push(vec![cell]),
        }
    }
    for group in &groups {
        let point = point_name(group[0]);
        draw(folder, &format!("load-{point}.svg"), &mut names, |path| {
            load(path, group)
        })?;
        if group.iter().any(|c| c.losses.len() > 1) {
            let name = format!("loss-{point}.svg");
            draw(folder, &name, &mut names, |path| losses(path, group))?;
        }
    }
    Ok(names)
}

fn same_point(a: &Cell, b: &Cell) -> bool {
    let key = |c: &Cell| (c.job.load, c.job.f_sw_hz, c.job.snr_db);
    key(a) == key(b)
}

fn point_name(cell: &Cell) -> String {
    let load = match cell.job.load {
        LoadKind::Field => "field",
        LoadKind::Surrogate => "reduced",
        LoadKind::Behavioural => "behavioural",
    };
    let snr = cell
        .job
        .snr_db
        .map_or("clean".into(), |db| format!("{db}dB"));
    format!("{load}-{}kHz-{snr}", cell.job.f_sw_hz * 1e-3)
}

fn draw(
    folder: &Path,
    name: &str,
    names: &mut Vec<String>,
    drawing: impl FnOnce(&Path) -> Drawn,
) -> Result<(), FigureError> {
    let path = folder.join(name);
    drawing(&path).map_err(|why| FigureError::new(&path, &why))?;
    names.push(name.to_owned());
    Ok(())
}

/// R above L over the half-cycle.
fn load(path: &Path, cells: &[&Cell]) -> Drawn {
    let root = SVGBackend::new(path, (900, 680)).into_drawing_area();
    root.fill(&WHITE)?;
    let root = root.titled(&point_name(cells[0]), ("sans-serif", 20))?;
    let areas = root.split_evenly((2, 1));
    type Value = fn(&(f64, f64, f64)) -> f64;
    let quantities: [(&str, Value); 2] = [("R / Ω", |p| p.1), ("L / µH", |p| p.2 * 1e6)];
    for (area, (label, value)) in areas.iter().zip(quantities) {
        let start_s = cells[0].truth.first().map_or(0.0, |p| p.0);
        let curve = |name: &str, trajectory: &[(f64, f64, f64)], style: Style| Curve {
            style,
            name: name.to_owned(),
            points: trajectory
                .iter()
                .map(|p| ((p.0 - start_s) * 1e3, value(p)))
                .collect(),
        };
        let mut curves = vec![curve("truth", &cells[0].truth, Style::Reference)];
        for (k, cell) in cells.iter().enumerate() {
            let name = cell.job.contender.name();
            curves.push(curve(name, &cell.trajectory, Style::Solid(k)));
        }
        // What fails may be far off: the truth's range sets the axis.
        let truth = curves[0].points.iter().map(|p| p.1);
        let (low, high) = truth.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
        let air = 0.25 * (high - low).max(1e-3);
        let axis = (low - air)..(high + air);
        let titles = ["time in the half-cycle / ms", label];
        let legend = SeriesLabelPosition::UpperMiddle;
        lines(area, titles, axis, &curves, legend)?;
    }
    root.present()?;
    Ok(())
}

/// Physics and data terms over the steps, both axes logarithmic: shown as powers of ten. With noise its
/// part of the data term is there too: what the VI branch must not go below.
fn losses(path: &Path, cells: &[&Cell]) -> Drawn {
    let root = SVGBackend::new(path, (900, 480)).into_drawing_area();
    root.fill(&WHITE)?;
    let area = root.titled(
        &format!("{}: loss", point_name(cells[0])),
        ("sans-serif", 20),
    )?;
    let log = |x: f64| x.max(1e-16).log10();
    let mut curves = Vec::new();
    let trained = |c: &&&Cell| matches!(c.job.contender, Contender::Pinn(_));
    for (k, cell) in cells.iter().filter(trained).enumerate() {
        let name = cell.job.contender.name();
        let steps = || cell.losses.iter().map(|l| log(l.step as f64));
        let l_f = steps()
            .zip(cell.losses.iter().map(|l| log(l.l_f)))
            .collect();
        let l_i = steps()
            .zip(cell.losses.iter().map(|l| log(l.l_i)))
            .collect();
        curves.push(Curve {
            style: Style::Solid(k),
            name: format!("{name}: physics L_f"),
            points: l_f,
        });
        curves.push(Curve {
            style: Style::Broken(k),
            name: format!("{name}: data L_i"),
            points: l_i,
        });
    }
    let last = cells.iter().filter_map(|c| c.losses.last()).map(|l| l.step);
    if let (Some(noise), Some(last)) = (cells[0].noise_in_samples, last.max()) {
        let (from, to) = (0.0, log(last as f64));
        // First, so that it lies under the others.
        let noise = Curve {
            style: Style::Reference,
            name: "noise of the samples in L_i".to_owned(),
            points: vec![(from, log(noise)), (to, log(noise))],
        };
        curves.insert(0, noise);
    }
    let values = curves.iter().flat_map(|c| c.points.iter().map(|p| p.1));
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    let axis = (low - 0.3)..(high + 0.3);
    let titles = ["log10 of the step", "log10 of the loss term"];
    lines(
        &area,
        titles,
        axis,
        &curves,
        SeriesLabelPosition::LowerRight,
    )?;
    root.present()?;
    Ok(())
}

fn lines(
    area: &Area<'_>,
    [x, y]: [&str; 2],
    axis: Range<f64>,
    curves: &[Curve],
    legend: SeriesLabelPosition,
) -> Drawn {
    let times = curves.iter().flat_map(|c| c.points.iter().map(|p| p.0));
    let (from, to) = times.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(56)
        .build_cartesian_2d(from..to.max(from + 1e-6), axis.clone())?;
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .light_line_style(WHITE)
        .draw()?;
    for curve in curves {
        let inside = curve.points.iter();
        let inside = inside.map(|p| (p.0, p.1.clamp(axis.start, axis.end)));
        let style = match curve.style {
            Style::Reference => RGBColor(120, 120, 120).stroke_width(5),
            Style::Solid(k) | Style::Broken(k) => Palette99::pick(k).stroke_width(2),
        };
        let drawn = match curve.style {
            Style::Broken(_) => chart.draw_series(DashedLineSeries::new(inside, 6, 4, style))?,
            Style::Reference | Style::Solid(_) => {
                chart.draw_series(LineSeries::new(inside, style))?
            }
        };
        let mark = move |(x, y)| match curve.style {
            Style::Broken(_) => PathElement::new([(x, y), (x + 7, y)], style),
            Style::Reference | Style::Solid(_) => PathElement::new([(x, y), (x + 18, y)], style),
        };
        drawn.label(&curve.name).legend(mark);
    }
    chart
        .configure_series_labels()
        .position(legend)
        .background_style(WHITE.mix(0.8))
        .border_style(RGBColor(120, 120, 120))
        .draw()?;
    Ok(())
}
