//! Physics of a pot: R and L of the fundamental at any frequency and current, from few numbers.
//!
//! The gap between coil and pot is linear and depends on the base's radius and its lift ([`crate::gap_table`]). A ring
//! of the base passes the flux µ δ F(|H|/α) = s √(2/ω) F(|H|/α) with one function F for all metals
//! ([`ihd_field::surface`]), so that α and s = √(µ/σ) describe a metal. Temperature changes s alone, by resistivity
//! and saturation; α stays.

use std::f64::consts::{PI, TAU};

use ihd_signal::Load;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use crate::gap_table::Gap;
use crate::sector::Sector;

/// Directions, over half a turn, in which the rim of a pot off centre is evaluated.
const SECTORS: usize = 3;

/// Offset in metre below which a pot counts as centred: the impedance changes by less than a thousandth.
const MIN_OFFSET_M: f64 = 0.5e-3;

/// Numbers of a pot over the coil of the paper (section IV).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PotModel {
    /// ln of the field α in A/m at which the metal's permeability has halved.
    pub ln_alpha: f64,
    /// ln of s = √(µ/σ) in √(H/S), with µ and σ at zero field.
    pub ln_s: f64,
    /// Radius of the base in metre.
    pub radius_m: f64,
    /// Height above the usual place in metre.
    pub lift_m: f64,
    /// Distance of the pot's axis from the coil's in metre.
    pub offset_m: f64,
    /// ln of the turns that act on the field, over the turns of the paper's coil.
    pub ln_turns: f64,
    /// Resistance of winding and leads in ohm.
    pub winding_r_ohm: f64,
}

/// Relative changes of R and L per change of a parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensitivity {
    /// d ln R.
    pub ln_r: f64,
    /// d ln L.
    pub ln_l: f64,
}

/// Relative changes of R and L by each number of a [`PotModel`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivities {
    /// By ln α.
    pub ln_alpha: Sensitivity,
    /// By ln s: effect of heat.
    pub ln_s: Sensitivity,
    /// By the base's radius, per metre.
    pub radius: Sensitivity,
    /// By lift, per metre.
    pub lift: Sensitivity,
    /// By the offset, per metre; zero for a centred pot.
    pub offset: Sensitivity,
    /// By ln of the turns.
    pub ln_turns: Sensitivity,
    /// By the winding's resistance, per ohm.
    pub winding: Sensitivity,
}

impl PotModel {
    /// The paper's load: ferritic steel, 21 cm.
    pub const PAPER: Self = Self {
        ln_alpha: 7.313_220_387_090_301,
        ln_s: -11.257_512_653_087_232,
        radius_m: 0.105,
        lift_m: 0.0,
        offset_m: 0.0,
        ln_turns: 0.0,
        winding_r_ohm: 0.0,
    };

    /// R and L at a switching frequency in hertz and an amplitude of the current's fundamental in ampere.
    pub fn impedance(&self, f_hz: f64, i_a: f64) -> Load {
        self.at_frequency(f_hz).impedance(i_a)
    }

    /// Model at one frequency for several currents; rising currents are quickest.
    pub fn at_frequency(&self, f_hz: f64) -> FrequencyModel {
        FrequencyModel::new(self, f_hz)
    }

    /// R and L at a switching frequency in hertz and an amplitude of the current's fundamental in ampere, with their changes by each
    /// number.
    pub fn sensitivities(&self, f_hz: f64, i_a: f64) -> (Load, Sensitivities) {
        self.at_frequency(f_hz).sensitivities(i_a)
    }

    /// Rim in each direction.
    fn rims(&self) -> Vec<Rim> {
        if self.offset_m < MIN_OFFSET_M {
            return vec![Rim {
                at_m: self.radius_m,
                by_radius: 1.0,
                by_offset: 0.0,
            }];
        }
        (0..SECTORS)
            .map(|k| {
                // Seen from the coil's axis the rim is at d cos θ + √(R² − d² sin² θ).
                let angle = PI * (k as f64 + 0.5) / SECTORS as f64;
                let (s, c) = (self.offset_m * angle.sin(), self.offset_m * angle.cos());
                let root_m = (self.radius_m * self.radius_m - s * s).max(0.0).sqrt();
                let per_root = if root_m > 0.0 { 1.0 / root_m } else { 0.0 };
                Rim {
                    at_m: c + root_m,
                    by_radius: self.radius_m * per_root,
                    by_offset: angle.cos() - s * angle.sin() * per_root,
                }
            })
            .collect()
    }
}

/// Distance of a pot's rim from the coil's axis in one direction, and its changes by radius and offset.
#[derive(Clone, Copy, Debug)]
struct Rim {
    at_m: f64,
    by_radius: f64,
    by_offset: f64,
}

/// Pot at one switching frequency; keeps the field of the last current as the start for the next.
#[derive(Clone, Debug)]
pub struct FrequencyModel {
    omega: f64,
    /// s √(2/ω) in H/m · m.
    surface: f64,
    alpha: f64,
    turns: f64,
    winding_r_ohm: f64,
    lift_m: f64,
    rims: Vec<Rim>,
    sectors: Vec<Sector>,
    /// Changes of each sector's gap by its rim and by the lift, once they are needed.
    gap_slopes: Option<Vec<[Gap; 2]>>,
}

impl FrequencyModel {
    fn new(model: &PotModel, f_hz: f64) -> Self {
        let (omega, rims) = (TAU * f_hz, model.rims());
        let sector = |rim: &Rim| Sector::new(Gap::interpolate(rim.at_m, model.lift_m));
        Self {
            omega,
            surface: model.ln_s.exp() * (2.0 / omega).sqrt(),
            alpha: model.ln_alpha.exp(),
            turns: model.ln_turns.exp(),
            winding_r_ohm: model.winding_r_ohm,
            lift_m: model.lift_m,
            sectors: rims.iter().map(sector).collect(),
            rims,
            gap_slopes: None,
        }
    }

    /// R and L at an amplitude of the current's fundamental in ampere.
    pub fn impedance(&mut self, i_a: f64) -> Load {
        let (surface, alpha, turns) = (self.surface, self.alpha, self.turns);
        let count = self.sectors.len() as f64;
        let inductance = self
            .sectors
            .iter_mut()
            .map(|sector| sector.inductance(surface, alpha, turns * i_a))
            .sum::<Complex<f64>>()
            * (turns * turns / count);
        Load {
            r_ohm: self.winding_r_ohm - self.omega * inductance.im,
            l_h: inductance.re,
        }
    }

    /// R and L at an amplitude of the current's fundamental in ampere, with their changes by each number, from the solved field.
    pub fn sensitivities(&mut self, i_a: f64) -> (Load, Sensitivities) {
        let load = self.impedance(i_a);
        let (surface, alpha) = (self.surface, self.alpha);
        let scale = self.turns * self.turns / self.sectors.len() as f64;
        let relative = |inductance: Complex<f64>| Sensitivity {
            ln_r: -self.omega * inductance.im * scale / load.r_ohm,
            ln_l: inductance.re * scale / load.l_h,
        };
        let zero = Complex::new(0.0, 0.0);
        let [
            mut whole,
            mut ln_alpha,
            mut ln_s,
            mut radius,
            mut lift,
            mut offset,
        ] = [zero; 6];
        let gap_slopes = self.gap_slopes.get_or_insert_with(|| {
            let of_rim = |rim: &Rim| Gap::slopes(rim.at_m, self.lift_m);
            self.rims.iter().map(of_rim).collect()
        });
        let directions = self.sectors.iter().zip(&self.rims).zip(gap_slopes);
        for ((sector, rim), by_gap) in directions {
            let slopes = sector.slopes(surface, alpha, by_gap);
            whole += slopes.inductance;
            ln_alpha += slopes.by_ln_alpha;
            ln_s += slopes.by_ln_s;
            radius += slopes.by_gap[0] * rim.by_radius;
            offset += slopes.by_gap[0] * rim.by_offset;
            lift += slopes.by_gap[1];
        }
        let all = Sensitivities {
            ln_alpha: relative(ln_alpha),
            ln_s: relative(ln_s),
            radius: relative(radius),
            lift: relative(lift),
            offset: relative(offset),
            // The field depends on the current over α alone.
            ln_turns: relative(whole * 2.0 - ln_alpha),
            winding: Sensitivity {
                ln_r: 1.0 / load.r_ohm,
                ln_l: 0.0,
            },
        };
        (load, all)
    }
}

#[cfg(test)]
mod tests;
