//! Extreme of ΔT, and what heat says about the fall after it.

use crate::metal::MetalLaw;
use crate::prior::CAPACITY_MARGIN;

/// Largest fall over what the base warmed meanwhile, or before in the same time. Near the turn the filter lags, first behind the rise and then behind the fall.
pub(crate) const MAX_FALL: f64 = 2.0;

/// Standard deviations of the alloy's effect by which a turn may lie lower.
const ALLOY_SIGMAS: f64 = 2.0;

/// ΔT with its standard deviation, and what heats the pot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnoverInput {
    /// Time in seconds.
    pub t_s: f64,
    /// ΔT in kelvin on the present side.
    pub rise_k: f64,
    /// Standard deviation of ΔT in kelvin, without the alloy's.
    pub sigma_k: f64,
    /// Mean power in watt.
    pub power_w: f64,
    /// Heat capacity of the base in J/K.
    pub base_j_per_k: f64,
    /// Relative standard deviation of the alloy's effect.
    pub spread: f64,
}

/// Largest ΔT, or least beyond the turn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extreme {
    pub rise_k: f64,
    pub t_s: f64,
    pub power_w: f64,
    /// Rate in K/s at which ΔT rose before.
    pub rate: f64,
    /// Heat in joule since then.
    pub heat_j: f64,
}

impl Extreme {
    /// Effect of heat over the law's maximum.
    pub fn effect_share(&self, metal: &MetalLaw) -> f64 {
        metal.ln_s_change(self.rise_k).0 / metal.ln_s_change(metal.turning_rise_k()).0
    }

    /// Returns `true` if it may be the turn of an alloy of this class.
    pub fn is_near_turn(&self, metal: &MetalLaw, now: &TurnoverInput) -> bool {
        self.effect_share(metal) > 1.0 - ALLOY_SIGMAS * now.spread.min(MetalLaw::SPREAD)
    }

    /// Returns `true` if ΔT falls no faster than the base warmed before, and by what the power has changed.
    pub fn is_mirrored(&self, now: &TurnoverInput) -> bool {
        let lasted_s = now.t_s - self.t_s;
        let more_k = (self.heat_j - self.power_w * lasted_s) / now.base_j_per_k;
        self.rise_k - now.rise_k < MAX_FALL * (self.rate * lasted_s + more_k)
    }

    /// Returns `true` if all heat since then could have warmed the base by as much as ΔT fell.
    pub fn is_possible(&self, now: &TurnoverInput) -> bool {
        self.rise_k - now.rise_k < CAPACITY_MARGIN * self.heat_j / now.base_j_per_k
    }
}
