//! Coefficients of the depth nodes: one metal under all rings, or a foil and a base.

use std::fmt::Debug;

use crate::depth::DepthGrid;
use crate::error::FieldError;
use crate::material::{BhCurve, Knee, Material};
use crate::model::Rings;
use crate::profile::{Metals, Profile};

/// Share of the time step in second-order backward differences: dB/dt = (1.5 B − …)/dt.
const BDF2: f64 = 1.5;

/// Coefficients of all nodes, of `N` rings each; both sides of the diffusion equation may be scaled.
pub trait NodeCoefficients<const N: usize>: Clone + Debug {
    /// 1.5 cell/dt, scaled.
    fn storage(&self, node: usize) -> [f64; N];

    /// 1/(σ distance to the next node), scaled.
    fn conductance(&self, node: usize) -> [f64; N];

    /// dt/1.5 over the scale.
    fn unit(&self) -> f64;

    /// Scale over σ and distance: what makes ∫ J²/σ of a scaled conductance.
    #[cfg(test)]
    fn loss_unit(&self) -> f64;

    /// Slope and offset of B = slope·H + offset at a node's trial field.
    fn tangent(&self, node: usize, trial: &[f64; N]) -> ([f64; N], [f64; N]);

    /// Changes the time step, in second.
    fn set_dt(&mut self, dt_s: f64);

    /// Changes the metals; the nodes stay.
    ///
    /// # Errors
    /// [`FieldError`] of a law that has no time domain here.
    fn set_metals(&mut self, metals: &Metals) -> Result<(), FieldError>;
}

/// One metal; scaled by its σ.
#[derive(Clone, Debug)]
pub struct OneMetal {
    depth: DepthGrid,
    dt_s: f64,
    sigma: f64,
    curve: BhCurve,
    storage: Vec<f64>,
    conductance: Vec<f64>,
}

impl OneMetal {
    /// Coefficients of a load without a foil.
    pub(super) fn new(model: &Rings, dt_s: f64) -> Result<Self, FieldError> {
        let (metal, depth) = (&model.metals.base, &model.profiles[0].depth);
        has_time_domain(metal)?;
        let mut nodes = Self {
            depth: depth.clone(),
            dt_s,
            sigma: metal.sigma_s_per_m(),
            curve: metal.curve(),
            storage: vec![0.0; depth.nodes()],
            conductance: depth.step_m.iter().map(|step| 1.0 / step).collect(),
        };
        nodes.scale();
        Ok(nodes)
    }

    fn scale(&mut self) {
        for (storage, cell) in self.storage.iter_mut().zip(&self.depth.cell_m) {
            *storage = BDF2 * self.sigma * cell / self.dt_s;
        }
    }
}

impl<const N: usize> NodeCoefficients<N> for OneMetal {
    #[inline(always)]
    fn storage(&self, node: usize) -> [f64; N] {
        [self.storage[node]; N]
    }

    #[inline(always)]
    fn conductance(&self, node: usize) -> [f64; N] {
        [self.conductance[node]; N]
    }

    #[inline(always)]
    fn unit(&self) -> f64 {
        self.dt_s / (BDF2 * self.sigma)
    }

    #[cfg(test)]
    fn loss_unit(&self) -> f64 {
        1.0 / self.sigma
    }

    #[inline(always)]
    fn tangent(&self, _: usize, trial: &[f64; N]) -> ([f64; N], [f64; N]) {
        let (mut slope, mut offset) = ([0.0; N], [0.0; N]);
        let curve = self.curve;
        match curve.knee {
            Knee::Froehlich => {
                let BhCurve {
                    alpha_a_per_m,
                    saturating,
                    b_sat_t,
                    ..
                } = curve;
                for j in 0..N {
                    (slope[j], offset[j]) =
                        froehlich_tangent(alpha_a_per_m, saturating, b_sat_t, trial[j]);
                }
            }
            // Refused by `has_time_domain`.
            Knee::Literal => {}
            Knee::Sharp => {
                let square = curve.alpha_a_per_m * curve.alpha_a_per_m;
                for j in 0..N {
                    let q = 1.0 / (square + trial[j] * trial[j]).sqrt();
                    let chord = curve.b_sat_t * q;
                    slope[j] = chord * square * q * q;
                    offset[j] = (chord - slope[j]) * trial[j];
                }
            }
        }
        for slope in &mut slope {
            *slope += curve.tail_h_per_m;
        }
        (slope, offset)
    }

    fn set_dt(&mut self, dt_s: f64) {
        self.dt_s = dt_s;
        self.scale();
    }

    fn set_metals(&mut self, metals: &Metals) -> Result<(), FieldError> {
        has_time_domain(&metals.base)?;
        self.sigma = metals.base.sigma_s_per_m();
        self.curve = metals.base.curve();
        self.scale();
        Ok(())
    }
}

/// Foil and base; not scaled. Both laws are Fröhlich's or linear.
#[derive(Clone, Debug)]
pub struct FoilAndBase<const N: usize> {
    profiles: Vec<Profile>,
    of_ring: Vec<usize>,
    dt_s: f64,
    cell_m: Vec<[f64; N]>,
    conductance: Vec<[f64; N]>,
    alpha_a_per_m: Vec<[f64; N]>,
    saturating: Vec<[f64; N]>,
    b_sat_t: Vec<[f64; N]>,
    tail_h_per_m: Vec<[f64; N]>,
}

impl<const N: usize> FoilAndBase<N> {
    /// Coefficients of a load with a foil.
    pub(super) fn new(model: &Rings, dt_s: f64) -> Result<Self, FieldError> {
        let nodes = model.profiles[0].depth.nodes();
        let blank = || vec![[0.0; N]; nodes];
        let mut all = Self {
            profiles: model.profiles.clone(),
            of_ring: model.of_ring.clone(),
            dt_s,
            cell_m: blank(),
            conductance: blank(),
            alpha_a_per_m: blank(),
            saturating: blank(),
            b_sat_t: blank(),
            tail_h_per_m: blank(),
        };
        NodeCoefficients::<N>::set_metals(&mut all, &model.metals)?;
        Ok(all)
    }
}

impl<const N: usize> NodeCoefficients<N> for FoilAndBase<N> {
    #[inline(always)]
    fn storage(&self, node: usize) -> [f64; N] {
        let rate = BDF2 / self.dt_s;
        self.cell_m[node].map(|cell| rate * cell)
    }

    #[inline(always)]
    fn conductance(&self, node: usize) -> [f64; N] {
        self.conductance[node]
    }

    #[inline(always)]
    fn unit(&self) -> f64 {
        self.dt_s / BDF2
    }

    #[cfg(test)]
    fn loss_unit(&self) -> f64 {
        1.0
    }

    #[inline(always)]
    fn tangent(&self, node: usize, trial: &[f64; N]) -> ([f64; N], [f64; N]) {
        let (mut slope, mut offset) = ([0.0; N], [0.0; N]);
        let (alpha, saturating) = (&self.alpha_a_per_m[node], &self.saturating[node]);
        let (b_sat, tail) = (&self.b_sat_t[node], &self.tail_h_per_m[node]);
        for j in 0..N {
            let (bent, beside) = froehlich_tangent(alpha[j], saturating[j], b_sat[j], trial[j]);
            (slope[j], offset[j]) = (bent + tail[j], beside);
        }
        (slope, offset)
    }

    fn set_dt(&mut self, dt_s: f64) {
        self.dt_s = dt_s;
    }

    fn set_metals(&mut self, metals: &Metals) -> Result<(), FieldError> {
        for metal in [&metals.base, &metals.foil] {
            if metal.curve().knee != Knee::Froehlich {
                return Err(FieldError::FoilLaw);
            }
        }
        let of = |profile: &Profile| (profile.sheet_s(metals), profile.curves(metals));
        let ways: Vec<_> = self.profiles.iter().map(of).collect();
        for (j, way) in self.of_ring.iter().enumerate() {
            let (sheet_s, curves) = &ways[*way];
            for (n, curve) in curves.iter().enumerate() {
                self.cell_m[n][j] = self.profiles[*way].depth.cell_m[n];
                self.conductance[n][j] = 1.0 / sheet_s[n];
                self.alpha_a_per_m[n][j] = curve.alpha_a_per_m;
                self.saturating[n][j] = curve.saturating;
                self.b_sat_t[n][j] = curve.b_sat_t;
                self.tail_h_per_m[n][j] = curve.tail_h_per_m;
            }
        }
        Ok(())
    }
}

/// Slope and offset of the tangent of b_sat · H / (α + s |H|) at a field in A/m.
#[inline(always)]
fn froehlich_tangent(alpha_a_per_m: f64, saturating: f64, b_sat_t: f64, h: f64) -> (f64, f64) {
    let q = 1.0 / (alpha_a_per_m + saturating * h.abs());
    let chord = b_sat_t * q;
    let slope = chord * alpha_a_per_m * q;
    (slope, (chord - slope) * h)
}

/// Checks that the law has a tangent at any field.
fn has_time_domain(metal: &Material) -> Result<(), FieldError> {
    if metal.curve().knee == Knee::Literal {
        return Err(FieldError::NoTimeDomain);
    }
    Ok(())
}
