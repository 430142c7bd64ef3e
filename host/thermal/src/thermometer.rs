//! Thermometer of one coil: half-cycles in; ΔT with its deviation, and events, out.

use crate::alloy::KnownAlloys;
use crate::batch::{Batches, ThermalHalfCycle};
use crate::contents::{BASE_J_PER_M2K, ContentsFit, WALL_J_PER_K};
use crate::filter::{PotMotion, ThermalFilter};
use crate::metal::MetalLaw;
use crate::placement::Placement;
use crate::pot_reading::{PotEvent, PotReading};
use crate::tracked_pot::TrackedPot;
use crate::turnover::TurnoverDetector;

/// Gap in seconds between half-cycles that ends a run: what happened to pot and power meanwhile is unknown.
pub const GAP_S: f64 = 120.0;

/// Time in seconds without heat after which a pot that seems moved may be another one: nobody exchanges pots faster.
const EXCHANGE_S: f64 = 2.0;

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
    /// Time in seconds without heat since the last batch, in which nothing shows the pot.
    unseen_s: f64,
    events: Vec<PotEvent>,
    /// Alloys of pots that boiled water here.
    alloys: KnownAlloys,
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
        if let Some((tracked, (metal, boil_k))) =
            self.tracked.as_ref().and_then(|t| Some((t, t.boil?)))
        {
            alloys.teach(&tracked.placed, &metal, boil_k);
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
        if !h.heats {
            self.unseen_s += dt_s;
        }
        self.last = Some(ThermalHalfCycle { power_w, ..*h });
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
                let to_tick_s = tracked.add_heat(h.t_s, dt_s, power_w);
                if let Some(batch) = batch {
                    let unseen_s = std::mem::take(&mut self.unseen_s);
                    if let PotMotion::Moved { lift_mm, straight } = tracked.add_batch(&batch) {
                        if unseen_s > EXCHANGE_S {
                            return self.begin_anew();
                        }
                        self.events.push(PotEvent::Moved { lift_mm, straight });
                    }
                }
                if to_tick_s <= 0.0 {
                    tracked.tick(h.t_s, &mut self.events);
                }
            }
        }
    }

    fn place(&mut self, t_s: f64) {
        let Some(placed) = self.placement.place() else {
            return;
        };
        let is_sure = placed.is_sure();
        // At first all heat stays in the base.
        let radius_m = placed.pot.radius_m;
        let area_m2 = std::f64::consts::PI * radius_m * radius_m;
        let base_j_per_k = BASE_J_PER_M2K * area_m2 + WALL_J_PER_K;
        let power_w = self.last.map_or(0.0, |last| last.power_w);
        let (rise_k, rate_k_per_s) = (self.energy_j / base_j_per_k, power_w / base_j_per_k);
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
        let metal = placed.metal.with_effect(effect);
        let filter =
            ThermalFilter::new(placed.pot, metal, t_s, (rise_k, rate_k_per_s), base_j_per_k);
        self.tracked = Some(Box::new(TrackedPot {
            filter,
            placed,
            contents,
            boil: None,
            began_s: t_s,
            tick_s: t_s,
            energy_j: 0.0,
            heat_j: self.energy_j,
            off_s: f64::NEG_INFINITY,
            mean_w: power_w,
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
        self.tracked.as_ref().map(|tracked| tracked.reading())
    }

    /// Returns the events since the last call.
    pub fn take_events(&mut self) -> Vec<PotEvent> {
        std::mem::take(&mut self.events)
    }
}
