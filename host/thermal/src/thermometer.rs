//! Thermometer of one coil: half-cycles in; ΔT with its deviation, and events, out.

use serde::{Deserialize, Serialize};

use crate::alloy::KnownAlloys;
use crate::batch::{Batches, ThermalHalfCycle};
use crate::contents::{BASE_J_PER_M2K, ContentsFit, WALL_J_PER_K};
use crate::filter::{PotMotion, ThermalFilter};
use crate::metal::MetalLaw;
use crate::placement::{PlacedPot, Placement};
use crate::prior::HeatPrior;
use crate::turnover::{TurnoverDetector, TurnoverInput};

/// Gap in seconds between half-cycles that ends a run: what happened to pot and power meanwhile is unknown.
pub const GAP_S: f64 = 120.0;

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

/// χ² by which the other class of metals must be worse for this one to be certain: 3 σ.
const CLASS_CHI2: f64 = 9.0;

/// Deviation in kelvin above which ΔT is not used.
const UNKNOWN_K: f64 = 40.0;

/// Present state of a pot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PotReading {
    /// Time in seconds on the clock of the half-cycles.
    pub t_s: f64,
    /// Rise of the base's temperature since the pot was put on, in kelvin, within what its heat allows ([`HeatPrior`]).
    pub rise_k: f64,
    /// Standard deviation of the rise in kelvin, including the unknown alloy.
    pub sigma_k: f64,
    /// Rise in kelvin, and its standard deviation, by the heat alone, without R and L.
    pub prior_k: (f64, f64),
    /// Lift since the pot was put on, in mm.
    pub lift_mm: f64,
    /// Standard deviation of the lift in mm.
    pub lift_sigma_mm: f64,
    /// Set if bubbles carry most of the heat: the base is on its plateau.
    pub bubbles: bool,
    /// Set if all of the contents boil.
    pub boils: bool,
    /// Set if the pot is too hot to contain water.
    pub overheats: bool,
}

/// Event of a pot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "kebab-case")]
pub enum PotEvent {
    /// A pot was put on; ΔT begins at 0.
    Placed {
        /// Diameter of its base in metre, as far as R and L determine it.
        diameter_m: f64,
        /// Set if its metal is closer to cast iron than to ferritic steel.
        is_cast_iron: bool,
        /// Set if the class of metal is certain; else R and L lie between both, or were measured at too few operating points.
        is_sure: bool,
    },
    /// The pot was moved: R and L changed faster than heat can change them.
    Moved {
        /// Change of lift in mm.
        lift_mm: f64,
        /// Set if lift alone explains the change; else the pot was shifted, too.
        straight: bool,
    },
    /// The base reached its plateau: bubbles carry the heat.
    Bubbles,
    /// All of the contents boil.
    Boils {
        /// Beginning of boiling in seconds on the clock of the half-cycles.
        since_s: f64,
    },
    /// ΔT is higher than with water in the pot.
    Overheats {
        /// ΔT in kelvin.
        rise_k: f64,
        /// Set beyond the turn, where R and L fall with heat: toward the Curie point.
        toward_curie: bool,
    },
}

/// Thermometer of the pot on one coil. A pot that boils water teaches the effect of heat on its metal, which is used when it is put on
/// again.
#[derive(Clone, Debug, Default)]
pub struct Thermometer {
    last: Option<ThermalHalfCycle>,
    batches: Batches,
    placement: Placement,
    /// Energy in joule since the pot was put on, until it is identified.
    energy_j: f64,
    tracked: Option<Box<TrackedPot>>,
    events: Vec<PotEvent>,
    /// Alloys of pots that boiled water here.
    alloys: KnownAlloys,
}

#[derive(Clone, Debug)]
struct TrackedPot {
    placed: PlacedPot,
    filter: ThermalFilter,
    contents: ContentsFit,
    /// Last rise of the boiling point in kelvin; `None` if nothing boiled.
    boil_k: Option<f64>,
    /// Times in seconds at which the pot was put on, and of the last tick.
    began_s: f64,
    tick_s: f64,
    /// Heat in joule since the last tick, and since the pot was put on.
    energy_j: f64,
    heat_j: f64,
    /// Mean power over some bursts, in watt.
    mean_w: f64,
    /// Time at which the hob was off last, in seconds.
    off_s: f64,
    /// States whose events were already reported.
    bubbles: bool,
    boils: bool,
    overheats: bool,
    toward_curie: bool,
    turnover: TurnoverDetector,
    /// Relative standard deviation of the effect of heat on its metal.
    spread: f64,
    /// Set once the pot was too hot to contain water.
    no_water: bool,
}

impl Thermometer {
    /// Returns the alloys of pots that boiled water here.
    pub fn alloys(&self) -> &KnownAlloys {
        &self.alloys
    }

    /// Sets the alloys that are known from before, for the pots that are put on from now on.
    pub fn set_alloys(&mut self, alloys: KnownAlloys) {
        self.alloys = alloys;
    }

    /// Starts anew with ΔT = 0, for a pot that was taken away or may be another one.
    pub fn begin_anew(&mut self) {
        let events = std::mem::take(&mut self.events);
        let mut alloys = std::mem::take(&mut self.alloys);
        if let Some((tracked, boil_k)) = self.tracked.as_ref().and_then(|t| Some((t, t.boil_k?))) {
            alloys.teach(&tracked.placed, tracked.filter.metal(), boil_k);
        }
        *self = Self {
            events,
            alloys,
            ..Self::default()
        };
    }

    /// Adds a half-cycle. Time that goes backwards, or a gap of two minutes, starts anew.
    pub fn push(&mut self, h: &ThermalHalfCycle) {
        if !h.t_s.is_finite() {
            return;
        }
        let mut dt_s = self.last.map_or(0.0, |last| h.t_s - last.t_s);
        if !(0.0..=GAP_S).contains(&dt_s) {
            self.begin_anew();
            // The heat before belongs to the placement that ended.
            dt_s = 0.0;
        }
        // The power is held over lost half-cycles.
        let power_w = match h.power_w.is_finite() {
            true => h.power_w.max(0.0),
            false => 0.0,
        };
        let energy_j = power_w * dt_s;
        self.last = Some(*h);
        let batch = self.batches.push(h);
        match &mut self.tracked {
            None => {
                self.energy_j += energy_j;
                self.placement.push(h);
                if batch.is_some() {
                    self.place(h.t_s);
                }
            }
            Some(tracked) => {
                tracked.energy_j += energy_j;
                tracked.heat_j += energy_j;
                tracked.mean_power(h.t_s, dt_s, power_w);
                if let Some(batch) = batch {
                    tracked.filter.advance(batch.t_s, tracked.mean_w);
                    if let PotMotion::Moved { lift_mm, straight } = tracked.filter.update(&batch) {
                        self.events.push(PotEvent::Moved { lift_mm, straight });
                    }
                }
                if h.t_s - tracked.tick_s >= TICK_S {
                    tracked.tick(h.t_s, &mut self.events);
                }
            }
        }
    }

    fn place(&mut self, t_s: f64) {
        let Some(placed) = self.placement.place() else {
            return;
        };
        let is_sure = placed.margin > CLASS_CHI2;
        // At first all heat stays in the base.
        let radius_m = placed.pot.radius_m;
        let area_m2 = std::f64::consts::PI * radius_m * radius_m;
        let base_j_per_k = BASE_J_PER_M2K * area_m2 + WALL_J_PER_K;
        let rise_k = self.energy_j / base_j_per_k;
        let rate_k_per_s = self.last.map_or(0.0, |last| last.power_w) / base_j_per_k;
        self.events.push(PotEvent::Placed {
            diameter_m: 2.0 * placed.pot.radius_m,
            is_cast_iron: placed.metal == MetalLaw::CAST_IRON,
            is_sure,
        });
        let class_spread = match is_sure {
            true => MetalLaw::SPREAD,
            false => MetalLaw::CLASS_SPREAD,
        };
        let (effect, spread) = self.alloys.effect(&placed, class_spread);
        let mut contents = ContentsFit::new(placed.pot.radius_m, t_s);
        contents.push(t_s, self.energy_j, Some(rise_k));
        self.tracked = Some(Box::new(TrackedPot {
            filter: ThermalFilter::new(
                placed.pot,
                placed.metal.with_effect(effect),
                t_s,
                (rise_k, rate_k_per_s),
                base_j_per_k,
            ),
            placed,
            contents,
            boil_k: None,
            began_s: t_s,
            tick_s: t_s,
            energy_j: 0.0,
            heat_j: self.energy_j,
            off_s: f64::NEG_INFINITY,
            mean_w: self.last.map_or(0.0, |last| last.power_w),
            bubbles: false,
            boils: false,
            overheats: false,
            toward_curie: false,
            turnover: TurnoverDetector::default(),
            spread,
            no_water: false,
        }));
    }

    /// Present state of the pot; `None` until it is identified.
    pub fn reading(&self) -> Option<PotReading> {
        let tracked = self.tracked.as_ref()?;
        let (rise_k, filter_k) = tracked.filter.rise_k();
        let (lift_mm, lift_sigma_mm) = tracked.filter.lift_mm();
        let alloy_k = tracked.filter.metal().alloy_sigma_k(rise_k, tracked.spread);
        let since_s = tracked.tick_s - tracked.began_s;
        let prior = HeatPrior::new(tracked.heat_j, since_s, tracked.filter.base_j_per_k());
        let sigma_k = filter_k.hypot(alloy_k).hypot(tracked.other_side_k(rise_k));
        let (rise_k, sigma_k) = prior.posterior_k((rise_k, sigma_k));
        Some(PotReading {
            t_s: tracked.tick_s,
            rise_k,
            sigma_k,
            prior_k: prior.mean_k(),
            lift_mm,
            lift_sigma_mm,
            bubbles: tracked.bubbles,
            boils: tracked.boils,
            overheats: tracked.overheats,
        })
    }

    /// Evidence for boiling: χ² by which the model without boiling explains the curve worse.
    pub fn evidence(&self) -> f64 {
        let tracked = self.tracked.as_ref();
        tracked.map_or(0.0, |t| t.contents.state().evidence)
    }

    /// Returns the events since the last call.
    pub fn take_events(&mut self) -> Vec<PotEvent> {
        std::mem::take(&mut self.events)
    }
}

impl TrackedPot {
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

    fn tick(&mut self, t_s: f64, events: &mut Vec<PotEvent>) {
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
            let alloy = metal.with_effect(change.effect * metal.effect);
            self.filter.change_side(change.rise_k, alloy);
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
        self.boil_k = self.contents.boiling_point_k().or(self.boil_k);
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
                rise_k,
                toward_curie: curie,
            });
        }
        self.overheats = overheats || (self.overheats && rise_k > over_k);
        self.toward_curie = curie || (self.toward_curie && rise_k > over_k);
    }
}
