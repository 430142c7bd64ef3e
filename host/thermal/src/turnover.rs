//! Detection of the turnover: the side of the maximum of R and L over temperature on which a pot is.
//!
//! R and L grow with heat up to a rise of some 200 K and fall beyond it, so that the same R and L belong to two temperatures. The filter
//! alone would bounce off the turn from both sides. What it shows as cooling is judged against the heat: a base that goes on warming as
//! it did before comes down the other side about as fast as it rose. A fall that the heat does not explain has another cause (cold food).
//! The pot's side is in doubt while both are possible, until ΔT rises again or falls below 0 in spite of the heat.

use std::collections::VecDeque;

use crate::metal::MetalLaw;
use crate::reversal::{Extreme, MAX_FALL, TurnoverInput};

/// Distance of ΔT from its extreme, in kelvin, that noise does not explain.
const BACK_K: f64 = 6.0;

/// Duration of a reversal in seconds that near the turn needs no other proof: cold food cools a base as much within some seconds.
const SLOW_S: f64 = 12.0;

/// Fall of ΔT in that time, in kelvin, that noise does not explain once the turn is behind.
const FALLS_K: f64 = 0.5;

/// Time in seconds before the extreme over which the rate of warming counts: at the turn itself the filter has none.
const RATE_S: f64 = 40.0;

/// Time in seconds for which ΔT is kept: the longest for the last kelvins of a rise that is the mirror of a fall.
const HISTORY_S: f64 = 240.0;

/// Least effect of heat on ln s at the extreme, over its maximum, for an extreme that is near the turn. The rest allows for the filter's
/// own error.
const MIN_EFFECT_SHARE: f64 = 0.95;

/// ΔT in kelvin, less three standard deviations, below which a heated pot is no colder than when it was put on but beyond the turn.
const BELOW_START_K: f64 = -15.0;

/// Fall of ΔT beyond the turn under undiminished power, in kelvin, that shows that the pot is not there; and the effect over its
/// maximum from which on it counts: nearer to the turn noise is as large.
const COOLED_K: f64 = 18.0;
const FAR_EFFECT_SHARE: f64 = 0.9;

/// Power over that of the extreme: least value of constant heating, and largest value of less heating.
const POWER: (f64, f64) = (0.95, 0.5);

/// Time constant of the mean power in seconds.
const POWER_S: f64 = 15.0;

/// Change of the side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SideChange {
    /// ΔT in kelvin on the other side.
    pub rise_k: f64,
    /// Law of the metal: the extreme is its maximum.
    pub metal: MetalLaw,
}

/// Reversal whose cause is another one, or not known.
#[derive(Clone, Copy, Debug)]
struct Reversal {
    extreme: Extreme,
    /// Least ΔT since, or largest beyond the turn.
    least_k: f64,
    in_doubt: bool,
}

/// Detector of the passage of the turn, from ΔT and power.
#[derive(Clone, Debug, Default)]
pub struct TurnoverDetector {
    beyond: bool,
    last_s: Option<f64>,
    mean_w: f64,
    /// Power in watt at which the turn was passed.
    passed_w: f64,
    /// Largest ΔT beyond the turn.
    hottest_k: f64,
    extreme: Option<Extreme>,
    reversal: Option<Reversal>,
    /// Times and ΔT of the last minutes.
    history: VecDeque<(f64, f64)>,
}

impl TurnoverDetector {
    /// Returns `true` if the pot is beyond the turn.
    pub fn is_beyond(&self) -> bool {
        self.beyond
    }

    /// Returns `true` if the pot may be on either side.
    pub fn is_in_doubt(&self) -> bool {
        self.reversal.is_some_and(|r| r.in_doubt)
    }

    /// Adds ΔT and power at a time; returns ΔT on the other side if the pot is there, else `None`.
    pub fn update(&mut self, metal: &MetalLaw, now: &TurnoverInput) -> Option<SideChange> {
        let dt_s = self.last_s.map_or(0.0, |last_s| now.t_s - last_s).max(0.0);
        self.last_s = Some(now.t_s);
        self.mean_w += (1.0 - (-dt_s / POWER_S).exp()) * (now.power_w - self.mean_w);
        self.remember(now.t_s, now.rise_k);
        if !metal.turning_rise_k().is_finite() {
            return None;
        }
        if self.beyond
            && let Some(change) = self.go_back(metal, now)
        {
            return Some(change);
        }
        let heat_j = now.power_w * dt_s;
        if let Some(reversal) = self.reversal {
            let change = self.follow_reversal(reversal, metal, now, heat_j);
            if change.is_some() || self.reversal.is_some() {
                return change;
            }
        }
        self.follow_extreme(metal, now, heat_j)
    }

    /// Sign of ΔT's way from the start: all is mirrored beyond the turn.
    fn sign(&self) -> f64 {
        if self.beyond { -1.0 } else { 1.0 }
    }

    /// Leaves the side beyond the turn if ΔT shows that the pot is not there; returns the change that the filter needs for it.
    fn go_back(&mut self, metal: &MetalLaw, now: &TurnoverInput) -> Option<SideChange> {
        let turn_k = metal.turning_rise_k();
        self.hottest_k = self.hottest_k.max(now.rise_k);
        let is_heated = self.mean_w >= POWER.0 * self.passed_w;
        let top = metal.ln_s_change(turn_k).0;
        let was_far = metal.ln_s_change(self.hottest_k).0 < FAR_EFFECT_SHARE * top;
        if is_heated && was_far && self.hottest_k - now.rise_k > COOLED_K {
            return Some(self.change_side(metal, now.rise_k, 1.0));
        }
        if now.rise_k < turn_k - BACK_K {
            self.beyond = false;
            // The filter fell through the turn: with the heat that passed it, it bounced; with less, the pot has cooled.
            if self.mean_w > POWER.1 * self.passed_w {
                return Some(self.change_side(metal, now.rise_k, 1.0));
            }
            (self.extreme, self.reversal) = (None, None);
        }
        None
    }

    /// Adds heat in joule to a reversal; returns the change if it was the turn, and forgets the reversal once ΔT rises again.
    fn follow_reversal(
        &mut self,
        mut reversal: Reversal,
        metal: &MetalLaw,
        now: &TurnoverInput,
        heat_j: f64,
    ) -> Option<SideChange> {
        let sign = self.sign();
        reversal.extreme.heat_j += heat_j;
        if sign * now.rise_k < sign * reversal.least_k {
            reversal.least_k = now.rise_k;
        }
        self.reversal = Some(reversal);
        if reversal.in_doubt
            && let Some(share) = self.share_beyond(metal, now, &reversal.extreme)
        {
            return Some(self.pass(metal, now, &reversal.extreme, share));
        }
        if sign * (now.rise_k - reversal.least_k) >= BACK_K {
            // Extremes count anew.
            (self.reversal, self.extreme) = (None, None);
        }
        None
    }

    /// Follows the extreme of ΔT with heat in joule since, and judges the way back from it.
    fn follow_extreme(
        &mut self,
        metal: &MetalLaw,
        now: &TurnoverInput,
        heat_j: f64,
    ) -> Option<SideChange> {
        let sign = self.sign();
        let here = Extreme {
            rise_k: now.rise_k,
            t_s: now.t_s,
            power_w: self.mean_w,
            rate: self.rate(now.t_s, now.rise_k),
            heat_j: 0.0,
        };
        let extreme = self.extreme.get_or_insert(here);
        if sign * (now.rise_k - extreme.rise_k) >= 0.0 {
            *extreme = here;
            return None;
        }
        extreme.heat_j += heat_j;
        let extreme = *extreme;
        if sign * (extreme.rise_k - now.rise_k) < BACK_K {
            return None;
        }
        self.judge(metal, now, extreme)
    }

    /// Judges a reversal by [`BACK_K`].
    fn judge(
        &mut self,
        metal: &MetalLaw,
        now: &TurnoverInput,
        extreme: Extreme,
    ) -> Option<SideChange> {
        if self.beyond {
            let is_off = self.mean_w <= POWER.1 * self.passed_w;
            if is_off && self.is_slow(metal, now, &extreme) {
                return Some(self.change_side(metal, now.rise_k, 1.0));
            }
            self.wait(now, extreme, false);
            return None;
        }
        if let Some(share) = self.share_beyond(metal, now, &extreme) {
            return Some(self.pass(metal, now, &extreme, share));
        }
        let may_be = self.is_heated(&extreme)
            && extreme.is_possible(now)
            && (extreme.is_near_turn(metal, now) || self.is_mirrored(now, &extreme));
        self.wait(now, extreme, may_be);
        None
    }

    /// Effect at the extreme over the law's maximum if the pot passed the turn there; else `None`.
    fn share_beyond(
        &self,
        metal: &MetalLaw,
        now: &TurnoverInput,
        extreme: &Extreme,
    ) -> Option<f64> {
        if self.beyond || !self.is_heated(extreme) {
            return None;
        }
        if self.is_slow(metal, now, extreme)
            || (extreme.is_near_turn(metal, now) && self.is_mirrored(now, extreme))
        {
            return Some(extreme.effect_share(metal));
        }
        // Whatever the pot's temperature was when it was put on.
        let is_below_start = now.rise_k + 3.0 * now.sigma_k < BELOW_START_K;
        is_below_start.then_some(1.0)
    }

    fn is_heated(&self, extreme: &Extreme) -> bool {
        extreme.power_w > 0.0 && self.mean_w >= POWER.0 * extreme.power_w
    }

    fn pass(
        &mut self,
        metal: &MetalLaw,
        now: &TurnoverInput,
        extreme: &Extreme,
        share: f64,
    ) -> SideChange {
        self.passed_w = extreme.power_w;
        self.change_side(metal, now.rise_k, share)
    }

    /// Adds ΔT to the history, and forgets what is too old.
    fn remember(&mut self, t_s: f64, rise_k: f64) {
        self.history.push_back((t_s, rise_k));
        let is_old = |(at_s, _): &(f64, f64)| t_s - at_s > HISTORY_S;
        while self.history.front().is_some_and(is_old) {
            self.history.pop_front();
        }
    }

    /// Rate in K/s over the last seconds.
    fn rate(&self, t_s: f64, rise_k: f64) -> f64 {
        let mut recent = self.history.iter().filter(|(at_s, _)| t_s - at_s <= RATE_S);
        let (at_s, before_k) = recent.next().copied().unwrap_or((t_s, rise_k));
        (rise_k - before_k) / (t_s - at_s).max(1.0)
    }

    /// Returns `true` if ΔT has fallen slowly from an extreme at the turn itself, and falls on.
    fn is_slow(&self, metal: &MetalLaw, now: &TurnoverInput, extreme: &Extreme) -> bool {
        let sign = self.sign();
        let fall_k = sign * (extreme.rise_k - now.rise_k);
        let lasted_s = now.t_s - extreme.t_s;
        let is_before = |(at_s, _): &&(f64, f64)| now.t_s - at_s >= SLOW_S;
        let before = self.history.iter().rfind(is_before);
        extreme.effect_share(metal) > MIN_EFFECT_SHARE
            && fall_k < BACK_K / SLOW_S * lasted_s
            && before.is_some_and(|(_, rise_k)| sign * (rise_k - now.rise_k) > FALLS_K)
    }

    /// Returns `true` if ΔT falls about as it rose: by the rate before the extreme, or by the time for the same way.
    fn is_mirrored(&self, now: &TurnoverInput, extreme: &Extreme) -> bool {
        let is_below = |(at_s, rise_k): &&(f64, f64)| *at_s < extreme.t_s && *rise_k <= now.rise_k;
        let rose_s = self
            .history
            .iter()
            .rfind(is_below)
            .map(|(at_s, _)| extreme.t_s - at_s);
        extreme.is_mirrored(now) || rose_s.is_some_and(|s| s < MAX_FALL * (now.t_s - extreme.t_s))
    }

    fn wait(&mut self, now: &TurnoverInput, extreme: Extreme, in_doubt: bool) {
        self.reversal = Some(Reversal {
            extreme,
            least_k: now.rise_k,
            in_doubt,
        });
    }

    fn change_side(&mut self, metal: &MetalLaw, rise_k: f64, share: f64) -> SideChange {
        self.beyond = !self.beyond;
        (self.extreme, self.reversal) = (None, None);
        self.history.clear();
        let alloy = metal.with_effect(share.min(1.0) * metal.effect);
        let rise_k = alloy.rise_with_change_k(metal.ln_s_change(rise_k).0, self.beyond);
        self.hottest_k = rise_k;
        SideChange {
            rise_k,
            metal: alloy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Result for a curve of ΔT at 1 Hz.
    fn passed(curve: impl Fn(f64) -> f64, power_w: impl Fn(f64) -> f64) -> Option<f64> {
        let mut turnover = TurnoverDetector::default();
        (0..300).find_map(|t| {
            let t_s = f64::from(t);
            let now = TurnoverInput {
                t_s,
                rise_k: curve(t_s),
                sigma_k: 3.0,
                power_w: power_w(t_s),
                base_j_per_k: 545.0,
                spread: MetalLaw::SPREAD,
            };
            let change = turnover.update(&MetalLaw::FERRITIC, &now);
            change.map(|change| change.rise_k)
        })
    }

    #[test]
    fn a_slow_turn_back_under_the_same_power_is_the_turn() {
        let bounce = |t_s: f64| 176.0 - 0.005 * (t_s - 150.0) * (t_s - 150.0);
        assert!(passed(bounce, |_| 1000.0).is_some_and(|k| (190.0..215.0).contains(&k)));
        // A steel whose heat acts 12 % less, which creeps over a lower turn.
        let low = |t_s: f64| 124.0 - 0.0008 * (t_s - 150.0) * (t_s - 150.0);
        assert!(passed(low, |_| 600.0).is_some_and(|k| (190.0..260.0).contains(&k)));
        // The cook has turned it down.
        assert_eq!(
            passed(bounce, |t_s| if t_s < 145.0 { 1000.0 } else { 300.0 }),
            None
        );
        // Cold food.
        let food = |t_s: f64| 176.0 - 1.5 * (t_s - 150.0).clamp(0.0, 30.0);
        assert_eq!(passed(food, |_| 1000.0), None);
        // Far from the turn, and never colder than when it was put on.
        assert_eq!(
            passed(|t_s| (bounce(t_s) - 100.0).max(0.0), |_| 1000.0),
            None
        );
    }

    #[test]
    fn a_turn_is_found_however_fast_the_base_passes_it() {
        let turn_k = MetalLaw::FERRITIC.turning_rise_k();
        for rate in [0.2, 0.5, 0.7, 1.0, 2.0, 3.5] {
            let curve = |t_s: f64| turn_k - (rate * t_s - turn_k).abs();
            let heat = |_| 100.0 + 600.0 * rate;
            let seconds = (1.3 * turn_k / rate) as u32;
            let mut turnover = TurnoverDetector::default();
            let found = (0..2 * seconds).find_map(|k| {
                let t_s = 0.5 * f64::from(k);
                let now = TurnoverInput {
                    t_s,
                    rise_k: curve(t_s),
                    sigma_k: 3.0,
                    power_w: heat(t_s),
                    base_j_per_k: 545.0,
                    spread: MetalLaw::SPREAD,
                };
                let change = turnover.update(&MetalLaw::FERRITIC, &now)?;
                Some((rate * t_s, change.rise_k))
            });
            let (truth_k, found_k) = found.unwrap_or_else(|| panic!("{rate} K/s"));
            assert!(truth_k < turn_k + 12.0, "{rate} K/s: {truth_k}");
            assert!((found_k - truth_k).abs() < 12.0, "{rate} K/s: {found_k}");
        }
    }
}
