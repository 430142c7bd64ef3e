//! Builds lookups from windows of a pot at a few powers, and judges them.

use ihd_link::Client;
use ihd_map::{CurrentCurve, PotMap};
use ihd_pinn::{PinnConfig, PinnError};
use ihd_shared::hob::WINDING_R_OHM;
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::truth::MapTruth;
use ihd_sim::adc::ConverterNoise;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::inverter::InverterError;
use ihd_sim::map_truth::TrueLoad;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use ihd_sim::transport::SharedHob;
use ihd_sim::trial::Trial;
use ihd_train::learning::{curve, fit_window, unfiltered};
use ihd_train::lookup::BuiltLookup;
use ihd_train::{RunOptions, TrainingSource, run};

use super::places::PotPlacement;
use super::{LookupJudgement, MapOperatingPoint, MapPlan, MapRun};
use ihd::cli::simulated::RATED_RMS;

/// Integration step in seconds: a fifth of the bridge's edge, and some 500 per period, like the simulated hob.
const STEP_S: f64 = 40e-9;

/// Runs all seeds of a pot with a departure.
pub fn runs(
    plan: &MapPlan,
    placed: &PotPlacement,
    perturbation: Option<Perturbation>,
) -> Result<Vec<MapRun>, InverterError> {
    let pot = SimulatedPot {
        perturbation,
        ..placed.pot
    };
    let supply = match plan.closed_loop {
        true => HobConfig::default().supply,
        false => CaptureSpec::default().supply(),
    };
    let truth = TrueLoad::new(plan.load, &pot, None)?
        .fed_by(supply)
        .map(&mut |_| ())?;
    let heated = truth.reached() > 0;
    let points = if heated && !plan.closed_loop {
        points(plan.load, &plan.powers_w, &pot)?
    } else {
        Vec::new()
    };
    let mut runs = Vec::new();
    for seed in 1..=plan.seeds {
        let mut run = MapRun {
            pot: placed.name.clone(),
            perturbation,
            seed,
            reached: truth.reached(),
            shown: points.iter().map(|p| p.shown).collect(),
            map: None,
            learned: None,
        };
        if heated && plan.closed_loop {
            (run.shown, run.learned) = closed_loop(plan, &pot, seed, &truth)?;
        } else if heated {
            run.map = Some(match curves(plan, &points, seed) {
                Ok(curves) => mapped(curves, &truth),
                Err(why) => LookupJudgement::refused(why.to_string()),
            });
        }
        runs.push(run);
        if !heated {
            break;
        }
    }
    Ok(runs)
}

/// Power, and a half-cycle at it.
pub struct Point {
    /// Operating point.
    pub shown: MapOperatingPoint,
    /// The half-cycle, without noise.
    pub trial: Trial,
}

/// Half-cycles from rest at the operating points at which the hob would heat with each power. They come from the table; the field
/// model's own frequency differs by a percent.
///
/// [`InverterError`] if the simulator cannot simulate the pot.
pub fn points(
    kind: LoadKind,
    powers_w: &[u16],
    pot: &SimulatedPot,
) -> Result<Vec<Point>, InverterError> {
    let table = match kind {
        LoadKind::Field => LoadKind::Surrogate,
        kind => kind,
    };
    let load = TrueLoad::new(table, pot, None)?;
    let mut points = Vec::new();
    for &asked_w in powers_w {
        let curve = load.heated_with(f64::from(asked_w))?;
        let f_sw_hz = curve.f_sw_hz;
        let trial = Trial::record(&CaptureSpec {
            f_sw_hz,
            load: kind,
            pot: *pot,
            winding_r_ohm: WINDING_R_OHM,
            duration_s: 10e-3,
            dt_s: STEP_S,
            sensing: Sensing {
                rate: Rate::Locked,
                bits: 12,
                pole_hz: f64::from(ANTI_ALIAS_HZ),
                ..Sensing::default()
            },
            ..CaptureSpec::default()
        })?;
        let crest_a = trial.truth.iter().map(|t| t.i_a).fold(0.0, f64::max);
        points.push(Point {
            shown: MapOperatingPoint {
                asked_w,
                f_sw_hz: f_sw_hz.round() as u32,
                crest_a,
            },
            trial,
        });
    }
    Ok(points)
}

/// Curves that the network identifies from each half-cycle with a seed's noise.
fn curves(plan: &MapPlan, points: &[Point], seed: u64) -> Result<Vec<CurrentCurve>, PinnError> {
    let noise = ConverterNoise::from_snr_db(plan.snr_db, RATED_RMS.0, RATED_RMS.1);
    let curve_of = |(k, point): (usize, &Point)| {
        let segment = point.trial.with_noise(noise, seed * SEEDS_APART + k as u64);
        identified(&segment, k as f64 * APART_S)
    };
    points.iter().enumerate().map(curve_of).collect()
}

/// R and L over current of a half-cycle behind the board's filters at a time in seconds, from a newly initialised network.
///
/// # Errors
/// [`PinnError`] if the network cannot be trained on it.
pub fn identified(segment: &Segment, t_s: f64) -> Result<CurrentCurve, PinnError> {
    let config = PinnConfig {
        // The result must not depend on the machine's load.
        deterministic: true,
        ..PinnConfig::default()
    };
    let segment = &unfiltered(segment.clone());
    let identified = fit_window(segment, config, &mut |_| ())?;
    let noise = WhiteNoise::measure(segment);
    Ok(curve(segment, noise, &(&identified).into(), t_s))
}

/// Distance of the seeds of two runs, for independent noise of each of their windows.
pub const SEEDS_APART: u64 = 1_000;

/// Time between two windows in seconds.
pub const APART_S: f64 = 1.0;

/// Judges the map made of the curves.
fn mapped(curves: Vec<CurrentCurve>, truth: &MapTruth) -> LookupJudgement {
    let (mut map, mut now_s) = (PotMap::default(), 0.0);
    for curve in curves {
        now_s = curve.t_s;
        map.observe(curve);
    }
    map.refresh(now_s);
    let Some(cells) = map.cells(now_s) else {
        return LookupJudgement::refused("no window shows a load".into());
    };
    match BuiltLookup::from_cells(cells, 1) {
        Ok(built) => LookupJudgement::judge(&built, truth),
        Err(why) => LookupJudgement::refused(why.to_string()),
    }
}

/// Runs a training with the simulated hob, like `ihd trainer`.
fn closed_loop(
    plan: &MapPlan,
    pot: &SimulatedPot,
    seed: u64,
    truth: &MapTruth,
) -> Result<(Vec<MapOperatingPoint>, Option<LookupJudgement>), InverterError> {
    let hob = SharedHob::new(SimHob::assemble(&HobConfig {
        pot: *pot,
        load: plan.load,
        noise: ConverterNoise::from_snr_db(plan.snr_db, RATED_RMS.0, RATED_RMS.1),
        seed,
        ..HobConfig::default()
    })?);
    let client = match Client::connect(Box::new(hob)) {
        Ok(client) => client,
        Err(why) => return Ok((Vec::new(), Some(LookupJudgement::refused(why.to_string())))),
    };
    let known = || Some(truth.clone());
    let mut settings = RunOptions::new(
        TrainingSource::Powers(plan.powers_w.clone()),
        PinnConfig {
            deterministic: true,
            ..PinnConfig::default()
        },
    );
    settings.map_truth = Some(&known);
    let (report, why) = match run(client, None, &settings, &mut |_| ()) {
        Ok(report) => (report, None),
        Err(failed) => (failed.report, Some(failed.error.to_string())),
    };
    let shown = report.points.iter().map(|p| MapOperatingPoint {
        asked_w: p.asked_w.unwrap_or(0),
        f_sw_hz: p.f_sw_hz,
        crest_a: p.i_crest_a,
    });
    let verdict = match &report.built {
        Some(built) => LookupJudgement {
            refused: why,
            ..LookupJudgement::judge(built, truth)
        },
        None => LookupJudgement::refused(why.unwrap_or_else(|| "nothing was taught".into())),
    };
    Ok((shown.collect(), Some(verdict)))
}
