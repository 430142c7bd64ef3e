//! Pot that is followed: its curve of ΔT, the side of the turn, its contents, and the events of their changes.

use crate::batch::HalfCycleBatch;
use crate::contents::ContentsFit;
use crate::filter::{PotMotion, ThermalFilter};
use crate::metal::MetalLaw;
use crate::placement::PlacedPot;
use crate::pot_reading::{PotEvent, PotReading};
use crate::prior::HeatPrior;
use crate::reversal::TurnoverInput;
use crate::turnover::TurnoverDetector;

/// Period in seconds in which the curve is updated.
const TICK_S: f64 = 0.5;

/// Time constant of the mean power in seconds, used during bursts, which come once a second, and for as long after the last one.
const MEAN_S: f64 = 2.0;
const SHORT_S: f64 = 0.05;
const BURST_S: f64 = 3.0;

/// ΔT in kelvin above which overheating is reported, because nothing that holds water gets so hot; and below which it ends.
const OVERHEATS_K: (f64, f64) = (180.0, 150.0);

/// ΔT in kelvin above which boiling is not searched for. Water put on at 0 °C keeps the rise of its base below 120 K, and below
/// this limit with an alloy that differs by a tenth. A hotter pot has no water in it.
const NO_WATER_K: f64 = 140.0;

/// Deviation in kelvin above which ΔT is not used.
const UNKNOWN_K: f64 = 40.0;

/// Pot that was identified and is followed.
#[derive(Clone, Debug)]
pub(crate) struct TrackedPot {
    pub placed: PlacedPot,
    pub filter: ThermalFilter,
    pub contents: ContentsFit,
    /// Last rise of the boiling point in kelvin, by this law; `None` if nothing boiled.
    pub boil: Option<(MetalLaw, f64)>,
    /// Times in seconds at which the pot was put on, and of the last tick.
    pub began_s: f64,
    pub tick_s: f64,
    /// Heat in joule since the last tick, and since the pot was put on.
    pub energy_j: f64,
    pub heat_j: f64,
    /// Mean power over some bursts, in watt.
    pub mean_w: f64,
    /// Time at which the hob was off last, in seconds.
    pub off_s: f64,
    /// States whose events were already reported.
    pub bubbles: bool,
    pub boils: bool,
    pub overheats: bool,
    pub toward_curie: bool,
    pub turnover: TurnoverDetector,
    /// Relative standard deviation of the effect of heat on its metal.
    pub spread: f64,
    /// Set once the pot was too hot to contain water.
    pub no_water: bool,
}

impl TrackedPot {
    /// Adds heat by a half-cycle of `dt_s` seconds; returns the time until the next tick in seconds.
    pub fn add_heat(&mut self, t_s: f64, dt_s: f64, power_w: f64) -> f64 {
        self.energy_j += power_w * dt_s;
        self.heat_j += power_w * dt_s;
        self.mean_power(t_s, dt_s, power_w);
        self.tick_s + TICK_S - t_s
    }

    /// Updates ΔT and lift with a batch; returns the motion of the pot that it shows.
    pub fn add_batch(&mut self, batch: &HalfCycleBatch) -> PotMotion {
        self.filter.advance(batch.t_s, self.mean_w);
        self.filter.update(batch)
    }

    /// Present state.
    pub fn reading(&self) -> PotReading {
        let (rise_k, filter_k) = self.filter.rise_k();
        let (lift_mm, lift_sigma_mm) = self.filter.lift_mm();
        let alloy_k = self.filter.metal().alloy_sigma_k(rise_k, self.spread);
        let since_s = self.tick_s - self.began_s;
        let prior = HeatPrior::new(self.heat_j, since_s, self.filter.base_j_per_k());
        let sigma_k = filter_k.hypot(alloy_k).hypot(self.other_side_k(rise_k));
        // A warm start makes ΔT wrong in one direction: it widens the deviation and leaves the mean.
        let start_k = self
            .filter
            .metal()
            .start_sigma_k(rise_k, self.placed.is_heated_already);
        let (rise_k, sigma_k) = prior.posterior_k((rise_k, sigma_k));
        PotReading {
            t_s: self.tick_s,
            rise_k,
            sigma_k: sigma_k.hypot(start_k),
            prior_k: prior.mean_k(),
            lift_mm,
            lift_sigma_mm,
            bubbles: self.bubbles,
            boils: self.boils,
            overheats: self.overheats,
        }
    }

    /// Updates the mean power: the mean over bursts if there are any, else that of the half-cycle.
    fn mean_power(&mut self, t_s: f64, dt_s: f64, power_w: f64) {
        if power_w < 1.0 {
            self.off_s = t_s;
        }
        let memory_s = match t_s - self.off_s < BURST_S {
            true => MEAN_S,
            false => SHORT_S,
        };
        self.mean_w += (1.0 - (-dt_s.max(0.0) / memory_s).exp()) * (power_w - self.mean_w);
    }

    /// Updates the curve, and the states whose changes are events.
    pub fn tick(&mut self, t_s: f64, events: &mut Vec<PotEvent>) {
        self.tick_s = t_s;
        self.filter.advance(t_s, self.mean_w);
        let (rise_k, sigma_k) = self.filter.rise_k();
        let metal = *self.filter.metal();
        let now = TurnoverInput {
            t_s,
            rise_k,
            sigma_k,
            power_w: self.mean_w,
            base_j_per_k: self.filter.base_j_per_k(),
            spread: self.spread,
        };
        if let Some(change) = self.turnover.update(&metal, &now) {
            self.filter.change_side(change.rise_k, change.metal);
        }
        let (rise_k, sigma_k) = self.filter.rise_k();
        self.check_overheating(rise_k, sigma_k, events);
        let energy_j = std::mem::take(&mut self.energy_j);
        self.no_water |= rise_k > NO_WATER_K;
        if self.no_water {
            (self.bubbles, self.boils) = (false, false);
            return;
        }
        let is_known = sigma_k < UNKNOWN_K && !self.turnover.is_in_doubt();
        let known = is_known.then_some(rise_k);
        self.contents.push(t_s, energy_j, known);
        let state = self.contents.state();
        if state.bubbles && !self.bubbles {
            events.push(PotEvent::Bubbles);
        }
        self.bubbles = state.bubbles;
        if let Some(since_s) = state.boils_since_s.filter(|_| !self.boils) {
            events.push(PotEvent::Boils { since_s });
        }
        self.boils = state.boils;
        let boil_k = self.contents.boiling_point_k();
        self.boil = boil_k.map(|k| (*self.filter.metal(), k)).or(self.boil);
    }

    /// Distance in kelvin to the rise with the same R and L on the other side of the turn, if the pot may be there; else 0.
    fn other_side_k(&self, rise_k: f64) -> f64 {
        if !self.turnover.is_in_doubt() {
            return 0.0;
        }
        let metal = self.filter.metal();
        let to_beyond = !self.turnover.is_beyond();
        let other_k = metal.rise_with_change_k(metal.ln_s_change(rise_k).0, to_beyond);
        (other_k - rise_k).abs()
    }

    fn check_overheating(&mut self, rise_k: f64, sigma_k: f64, events: &mut Vec<PotEvent>) {
        let sigma_k = sigma_k.hypot(self.filter.metal().alloy_sigma_k(rise_k, self.spread));
        let (above_k, over_k) = OVERHEATS_K;
        let turn_k = self.filter.metal().turning_rise_k();
        let curie = self.turnover.is_beyond() || rise_k - sigma_k > turn_k;
        let overheats = rise_k - sigma_k > above_k;
        if (overheats && !self.overheats) || (curie && !self.toward_curie) {
            events.push(PotEvent::Overheats {
                // The filter's own rise may be more than the heat allows.
                rise_k: self.reading().rise_k,
                toward_curie: curie,
            });
        }
        self.overheats = overheats || (self.overheats && rise_k > over_k);
        self.toward_curie = curie || (self.toward_curie && rise_k > over_k);
    }
}
