//! Figure of the estimated ΔT with its deviation, and of the truth: boiling water in a pot that is moved, and an empty pot.

use std::path::Path;

use ihd_sim::contents::PotContents;
use ihd_sim::cooking::PotDeviation;
use ihd_sim::pot::{PotBase, SimulatedPot};
use plotters::prelude::*;

use super::kitchen::{Sample, cook};
use super::{CookingJob, CookingKind, TemperatureRun};
use ihd_plot::legend::header;
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, RED,
};
use ihd_plot::{FigureError, file};

/// Colour between the lines of ± σ.
const PALE: RGBColor = RGBColor(150, 190, 225);

/// Draws both runs to an SVG file.
///
/// # Errors
/// [`FigureError`] if a run cannot be made or the file cannot be written.
pub fn write(path: &Path) -> Result<(), FigureError> {
    let job = |kind, contents, power_w, duration_s, moved| CookingJob {
        seed: 11,
        noise_seed: 11,
        kind,
        pot: SimulatedPot {
            lift_m: 0.2e-3,
            ..SimulatedPot::new(PotBase::Ferritic, 0.18)
        },
        contents,
        deviation: PotDeviation {
            scale: (0.02, -0.01),
            slope: (0.01, 0.005),
            alloy: 0.05,
            bow_m: 0.1e-3,
        },
        power_w,
        duration_s,
        lessons: 0,
        moved,
    };
    let jobs = [
        (
            "1.5 l of water at 1600 W, ferritic-18, lifted by 0.8 mm at 150 s",
            job(
                CookingKind::Boil,
                PotContents::Water(1.5),
                1600.0,
                480.0,
                Some((150.0, 1e-3)),
            ),
        ),
        (
            "The same pot empty at 800 W: beyond 184 K R and L fall with heat",
            job(
                CookingKind::FoodToRest,
                PotContents::Empty,
                800.0,
                300.0,
                None,
            ),
        ),
    ];
    let mut panels = Vec::new();
    for (title, job) in &jobs {
        let mut samples = Vec::new();
        let run =
            cook(job, |sample| samples.push(sample)).map_err(|why| FigureError::new(path, &why))?;
        panels.push((*title, samples, run));
    }
    file::write(path, (1000, 760), |root| draw(root, &panels))
}

fn draw(root: &Area<'_>, panels: &[(&str, Vec<Sample>, TemperatureRun)]) -> DrawResult {
    let areas = root.split_evenly((panels.len(), 1));
    for (k, (area, (title, samples, run))) in areas.iter().zip(panels).enumerate() {
        let curve = |name: &str, colour, pen, value: fn(&Sample) -> f64| {
            let points = samples.iter().map(|s| (s.t_s, value(s)));
            PlotCurve::new(name, colour, pen, points.collect())
        };
        let curves = [
            curve("± σ", PALE, Pen::Line(1), |s| {
                s.estimate.rise_k + s.estimate.sigma_k
            }),
            curve("", PALE, Pen::Line(1), |s| {
                s.estimate.rise_k - s.estimate.sigma_k
            }),
            curve("found", BLUE, Pen::Line(2), |s| s.estimate.rise_k),
            curve("true", RED, Pen::Broken(2), |s| s.rise_k),
        ];
        let end_s = samples.last().map_or(1.0, |s| s.t_s);
        let top_k = plot::span(curves.iter().flat_map(PlotCurve::points).map(|p| p.1));
        let top_k = 1.08 * top_k.map_or(1.0, |(_, high)| high);
        // Times of the boil and of its report.
        let marks = [
            ("boils", RED, run.boils_s),
            ("said to", BLUE, run.boils_reported_s),
        ];
        let marks = marks.into_iter().filter_map(|(name, colour, at_s)| {
            let at_s = at_s?;
            Some(PlotCurve::new(
                name,
                colour,
                Pen::Broken(1),
                vec![(at_s, 0.0), (at_s, top_k)],
            ))
        });
        let all: Vec<PlotCurve> = curves.iter().cloned().chain(marks).collect();
        let entries: Vec<LegendEntry> = all
            .iter()
            .filter(|c| !c.name.is_empty())
            .map(plot::LegendEntry::from_curve)
            .collect();
        let panel = PlotPanel {
            x: Axis::linear(if k + 1 == panels.len() { "t / s" } else { "" }, 0.0..end_s),
            y: Axis::linear("ΔT / K", 0.0..top_k),
        };
        let below = header(area, title, &entries)?;
        let zero = PlotCurve::new("", GREY, Pen::Line(1), vec![(0.0, 0.0), (end_s, 0.0)]);
        plot::draw(&below, &panel, &[&[zero], all.as_slice()].concat())?;
    }
    Ok(())
}
