//! Figures of the study: R(t) and L(t) against the truth (the paper's Figs. 5 and 6), and loss curves.

use std::path::Path;

use plotters::prelude::*;

use super::{Contender, PaperCell};
use crate::load_name::load_name;
use ihd_plot::legend::{column, header};
use ihd_plot::panel::beyond;
use ihd_plot::{
    self as plot, Area, Axis, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, span,
};
use ihd_plot::{FigureError, file};

/// Width of the legend beside a panel, in pixels.
const LEGEND_PX: u32 = 250;

/// Colours of the contenders in order; by Okabe and Ito, suitable for the colour-blind.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
    RGBColor(146, 73, 0),
];

fn colour(contender: usize) -> RGBColor {
    COLOURS[contender % COLOURS.len()]
}

/// Draws all figures of the first seed into `folder`; returns their names.
pub fn all(cells: &[PaperCell], folder: &Path) -> Result<Vec<String>, FigureError> {
    let mut names = Vec::new();
    let mut groups: Vec<Vec<&PaperCell>> = Vec::new();
    for cell in cells {
        match groups.iter().position(|group| same_point(group[0], cell)) {
            Some(at) if groups[at][0].job.seed == cell.job.seed => groups[at].push(cell),
            Some(_) => {}
            None => groups.push(vec![cell]),
        }
    }
    for group in &groups {
        let point = point_name(group[0]);
        let name = format!("load-{point}.svg");
        draw(folder, &name, &mut names, (1000, 800), |root| {
            load(root, group)
        })?;
        if group.iter().any(|c| c.losses.len() > 1) {
            let name = format!("loss-{point}.svg");
            draw(folder, &name, &mut names, (1000, 560), |root| {
                losses(root, group)
            })?;
        }
    }
    Ok(names)
}

fn same_point(a: &PaperCell, b: &PaperCell) -> bool {
    let key = |c: &PaperCell| (c.job.load, c.job.f_sw_hz, c.job.snr_db);
    key(a) == key(b)
}

fn point_name(cell: &PaperCell) -> String {
    let load = load_name(cell.job.load);
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
    size: (u32, u32),
    drawing: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<(), FigureError> {
    file::write(&folder.join(name), size, drawing)?;
    names.push(name.to_owned());
    Ok(())
}

/// R above L over the half-cycle.
fn load(root: &Area<'_>, cells: &[&PaperCell]) -> DrawResult {
    let below = header(root, &point_name(cells[0]), &[])?;
    let areas = below.split_evenly((2, 1));
    type Value = fn(&(f64, f64, f64)) -> f64;
    let quantities: [(&str, Value); 2] = [("R / Ω", |p| p.1), ("L / µH", |p| p.2 * 1e6)];
    for (area, (label, value)) in areas.iter().zip(quantities) {
        let (panel, curves) = load_panel(cells, label, value);
        beside_legend(area, &panel, &curves)?;
    }
    Ok(())
}

/// One quantity over the half-cycle. A failed method may be far off: the truth's range sets the axis.
fn load_panel(
    cells: &[&PaperCell],
    label: &str,
    value: impl Fn(&(f64, f64, f64)) -> f64,
) -> (PlotPanel, Vec<PlotCurve>) {
    let start_s = cells[0].truth.first().map_or(0.0, |p| p.0);
    let points = |trajectory: &[(f64, f64, f64)]| {
        let of = trajectory.iter();
        of.map(|p| ((p.0 - start_s) * 1e3, value(p))).collect()
    };
    let mut curves = vec![PlotCurve::new(
        "truth",
        GREY,
        Pen::Line(6),
        points(&cells[0].truth),
    )];
    for (k, cell) in cells.iter().enumerate() {
        let name = cell.job.contender.name();
        let points = points(&cell.trajectory);
        curves.push(PlotCurve::new(name, colour(k), Pen::Line(2), points));
    }
    let (low, high) = span(curves[0].points().map(|p| p.1)).unwrap_or((0.0, 1.0));
    let air = 0.25 * (high - low).max(1e-3);
    let times = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.0)).unwrap_or((0.0, 1.0));
    let panel = PlotPanel {
        x: Axis::linear("time in the half-cycle / ms", times.0..times.1),
        y: Axis::linear(label, low - air..high + air),
    };
    (panel, curves)
}

/// Physics and data terms over the steps, both axes in decades. With noise its part of the data term is drawn: the VI branch must
/// not go below it.
fn losses(root: &Area<'_>, cells: &[&PaperCell]) -> DrawResult {
    let title = format!("{}: loss", point_name(cells[0]));
    let below = header(root, &title, &[])?;
    let curves = loss_curves(cells);
    let steps = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.0)).unwrap_or((1.0, 10.0));
    let terms = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.1)).unwrap_or((1.0, 10.0));
    let panel = PlotPanel {
        x: Axis::decades("step", steps.0..steps.1),
        y: Axis::decades("loss term", terms.0 / 2.0..terms.1 * 2.0),
    };
    beside_legend(&below, &panel, &curves)
}

/// Curves without terms that are zero, which have no place on an axis of decades.
fn loss_curves(cells: &[&PaperCell]) -> Vec<PlotCurve> {
    let mut curves = Vec::new();
    let trained = |c: &&&PaperCell| matches!(c.job.contender, Contender::Pinn(_));
    for (k, cell) in cells.iter().filter(trained).enumerate() {
        let name = cell.job.contender.name();
        let mut add = |term: &str, pen, value: fn(&super::LossAt) -> f64| {
            let points = cell.losses.iter().map(|l| (l.step as f64, value(l)));
            let points = points.filter(|p| p.0 > 0.0 && p.1 > 0.0).collect();
            curves.push(PlotCurve::new(
                &format!("{name}: {term}"),
                colour(k),
                pen,
                points,
            ));
        };
        add("physics L_f", Pen::Line(2), |l| l.l_f);
        add("data L_i", Pen::Broken(2), |l| l.l_i);
    }
    let steps = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.0));
    if let (Some(noise), Some((first, last))) = (cells[0].noise_in_samples, steps)
        && noise > 0.0
    {
        // First, so that it lies under the others.
        let points = vec![(first, noise), (last, noise)];
        let noise = PlotCurve::new("noise of the samples in L_i", GREY, Pen::Line(5), points);
        curves.insert(0, noise);
    }
    curves
}

/// Panel with its legend at the right, which states how far each curve extends beyond the frame.
fn beside_legend(area: &Area<'_>, panel: &PlotPanel, curves: &[PlotCurve]) -> DrawResult {
    let width = area.dim_in_pixel().0.saturating_sub(LEGEND_PX);
    let (left, right) = area.split_horizontally(width);
    let outside = plot::draw(&left, panel, curves)?;
    let entry = |(curve, outside): (&PlotCurve, &Vec<_>)| LegendEntry {
        note: beyond(outside),
        ..LegendEntry::from_curve(curve)
    };
    let entries: Vec<LegendEntry> = curves.iter().zip(&outside).map(entry).collect();
    column(&right, &entries)
}

#[cfg(test)]
mod tests {
    use ihd_identify::Method;
    use ihd_sim::recording::settings::LoadKind;

    use super::super::{LossAt, PaperErrors, PaperJob};
    use super::*;
    use ihd_plot::svg::Picture;

    fn cell(contender: Contender, r_ohm: f64, losses: Vec<LossAt>) -> PaperCell {
        let trajectory = |r: f64| {
            let at = (0..=100).map(|k| 1e-4 * f64::from(k));
            at.map(|t| (t, r + 100.0 * t, 20e-6)).collect()
        };
        let errors = PaperErrors {
            r_pct: 0.0,
            l_pct: 0.0,
        };
        PaperCell {
            build: String::new(),
            job: PaperJob {
                load: LoadKind::Behavioural,
                f_sw_hz: 45e3,
                snr_db: Some(30.0),
                contender,
                seed: 1,
                epochs: None,
                backend: None,
            },
            settings: None,
            whole: errors,
            middle: errors,
            describing: None,
            impedance_order: None,
            nmse_pct: None,
            nmse_filtered_pct: None,
            nmse_both_filtered_pct: None,
            nmse_unfiltered_itself_pct: None,
            power_r_pct: None,
            power_describing_pct: None,
            elapsed_s: 0.0,
            steps: 0,
            stopped: String::new(),
            trajectory: trajectory(r_ohm),
            truth: trajectory(3.0),
            noise_in_samples: Some(1e-3),
            losses,
        }
    }

    fn drawn(cells: &[PaperCell], name: &str) -> Picture {
        let folder = tempfile::tempdir().unwrap();
        let names = all(cells, folder.path()).unwrap();
        assert!(names.contains(&name.to_owned()), "{names:?}");
        Picture::read(&folder.path().join(name))
    }

    #[test]
    fn a_contender_beyond_the_axis_has_arrows_and_its_number_and_no_line() {
        let failed = cell(Contender::Pinn("paper-literal".into()), 7e5, vec![]);
        let good = cell(Contender::Other(Method::Ekf), 3.01, vec![]);
        let picture = drawn(&[failed, good], "load-behavioural-45kHz-30dB.svg");
        // Of R there is none; of L, where it is right, there is one, and one in each of the two legends.
        assert_eq!(picture.polylines("#0072B2").len(), 3);
        assert_eq!(picture.polylines("#D55E00").len(), 4);
        assert!(!picture.polygons("#0072B2").is_empty());
        assert!(picture.polygons("#D55E00").is_empty());
        assert!(picture.texts().contains(&"▲ to 7·10⁵".to_owned()));
    }

    #[test]
    fn losses_are_drawn_over_decades_of_steps() {
        let at = |step: usize, l_f: f64| LossAt {
            step,
            l_f,
            l_i: 1e-3,
        };
        let losses = vec![at(1, 1e2), at(10, 1e-2), at(1000, 0.0), at(1000, 1e-6)];
        let network = cell(Contender::Pinn("hybrid".into()), 3.0, losses);
        let texts = drawn(&[network], "loss-behavioural-45kHz-30dB.svg").texts();
        for label in ["10⁰", "10¹", "10²", "10³", "10⁻⁴", "step", "loss term"] {
            assert!(texts.contains(&label.to_owned()), "{label}: {texts:?}");
        }
        assert!(!texts.iter().any(|t| t.contains("log10")));
    }
}
