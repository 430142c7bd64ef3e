//! The hob that knows a pot, and the hob that gets it for the first time.

use ihd_map::{CurrentCurve, PotEntry, PotMap, Provenance};
use ihd_signal::truth::MapTruth;
use ihd_signal::{Load, Segment};
use ihd_sim::adc::ConverterNoise;
use ihd_sim::map_truth::TrueLoad;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::settings::LoadKind;

use super::PotError;
use crate::map::places::PotPlacement;
use crate::map::teach::{APART_S, Point, SEEDS_APART, identified, points};
use ihd::cli::simulated::RATED_RMS;

/// Powers in watt at which the first hob has cooked with the pot.
const KNOWN_AT_W: [u16; 5] = [500, 700, 1_000, 1_400, 2_000];

/// Requested powers of the second hob in watt, window by window.
pub const ASKED_W: [u16; 8] = [1_200, 1_200, 1_200, 700, 1_200, 2_000, 700, 2_000];

/// Noise of both hobs as a signal-to-noise ratio in decibel at the rated power.
const FIRST_SNR_DB: f64 = 40.0;
const SECOND_SNR_DB: f64 = 37.0;

/// Differences of the second hob: its glass is thicker, its winding warmer (10 % of copper's resistance are 25 K), its voltage
/// sensor reads more than its current sensor. Two resistors of 1 % and a glass of 4 mm ± 0.2 mm with a pot that is not flat cause
/// that.
const LIFT_M: f64 = 1e-3;
const WINDING_R_OHM: f64 = 0.01;
const GAIN: f64 = 1.01;

/// Distance of the first hob's seeds from the second one's, for independent noise.
const OF_FIRST: u64 = 500;

/// The pot on the first hob: centred, at its usual height, at room temperature.
pub fn at_home(pot: &SimulatedPot) -> SimulatedPot {
    SimulatedPot {
        lift_m: 0.0,
        offset_m: 0.0,
        temperature_c: SimulatedPot::NONE.temperature_c,
        ..*pot
    }
}

/// Returns `true` if both have the same metal and size.
pub fn is_same(a: &SimulatedPot, b: &SimulatedPot) -> bool {
    a.base == b.base && (a.diameter_m - b.diameter_m).abs() < 1e-6
}

/// Entry of the first hob for a pot; `None` if it has none.
///
/// # Errors
/// [`PotError`].
pub fn entry(
    load: LoadKind,
    pot: &SimulatedPot,
    name: &str,
    seed: u64,
) -> Result<Option<PotEntry>, PotError> {
    if TrueLoad::new(LoadKind::Surrogate, pot, None)?
        .map(&mut |_| ())?
        .reached()
        == 0
    {
        return Ok(None);
    }
    let noise = ConverterNoise::from_snr_db(FIRST_SNR_DB, RATED_RMS.0, RATED_RMS.1);
    let mut map = PotMap::default();
    let mut now_s = 0.0;
    for (k, point) in points(load, &KNOWN_AT_W, pot)?.iter().enumerate() {
        now_s = k as f64 * APART_S;
        let segment = point
            .trial
            .with_noise(noise, seed * SEEDS_APART + OF_FIRST + k as u64);
        map.observe(identified(&segment, now_s)?);
    }
    map.refresh(now_s);
    Ok(map.entry(Provenance {
        hob: format!("first-{name}"),
        build: env!("CARGO_PKG_VERSION").to_owned(),
        t_unix_s: 1_700_000_000,
    }))
}

/// Hob that gets a pot for the first time.
pub struct SecondHob {
    truth: MapTruth,
    points: Vec<Point>,
}

impl SecondHob {
    /// Creates the hob with a pot on it.
    ///
    /// # Errors
    /// [`PotError`] if the simulator cannot simulate the pot.
    pub fn new(
        load: LoadKind,
        placed: &PotPlacement,
        perturbation: Option<Perturbation>,
    ) -> Result<Self, PotError> {
        let pot = SimulatedPot {
            perturbation,
            lift_m: placed.pot.lift_m + LIFT_M,
            ..placed.pot
        };
        let truth = TrueLoad::new(load, &pot, None)?.map(&mut |_| ())?;
        let mut asked_w = ASKED_W.to_vec();
        asked_w.sort_unstable();
        asked_w.dedup();
        let points = match truth.reached() {
            0 => Vec::new(),
            _ => points(load, &asked_w, &pot)?,
        };
        Ok(Self {
            truth: MapTruth {
                cells: truth.cells.map(|row| row.map(|cell| cell.map(as_measured))),
            },
            points,
        })
    }

    /// Returns `true` if the hob heats it.
    pub fn is_heated(&self) -> bool {
        !self.points.is_empty()
    }

    /// R and L as measured by this hob.
    pub fn truth(&self) -> &MapTruth {
        &self.truth
    }

    /// Curves of its windows with a seed's noise, one per second.
    ///
    /// # Errors
    /// [`PotError`] if a network cannot be trained.
    pub fn curves(&self, seed: u64) -> Result<Vec<CurrentCurve>, PotError> {
        let noise = ConverterNoise::from_snr_db(SECOND_SNR_DB, RATED_RMS.0, RATED_RMS.1);
        let mut curves = Vec::new();
        for (k, asked_w) in ASKED_W.iter().enumerate() {
            let point = self.points.iter().find(|p| p.shown.asked_w == *asked_w);
            let Some(point) = point else { continue };
            let clean = point.trial.with_noise(noise, seed * SEEDS_APART + k as u64);
            curves.push(identified(&seen(&clean), k as f64 * APART_S)?);
        }
        Ok(curves)
    }
}

fn as_measured(load: Load) -> Load {
    Load {
        r_ohm: GAIN * (load.r_ohm + WINDING_R_OHM),
        l_h: GAIN * load.l_h,
    }
}

/// Passes a half-cycle through this hob's winding and sensors.
fn seen(segment: &Segment) -> Segment {
    let pairs = segment.v_v.iter().zip(segment.i_a.iter());
    let v_v = pairs.map(|(v, i)| GAIN * (v + WINDING_R_OHM * i)).collect();
    segment.with_samples(v_v, segment.i_a.to_vec())
}
