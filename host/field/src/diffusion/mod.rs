//! Time stepping of the field inside the load, all rings side by side.
//!
//! Under ring j: σ ∂B/∂t = ∂²H/∂z², B = B(H). Finite volumes along depth, second-order backward differences (BDF2) in time, and
//! one Newton step per time step from the extrapolated field. The extrapolation is wrong by O(dt²), so that Newton's remainder
//! is O(dt⁴); the tests compare with a converged iteration. Rings are the innermost index, so that the compiler vectorises over
//! them.
//!
//! A step has two halves, because the circuit determines the current of the new instant:
//! [`RingLoad::predict`] eliminates the field down to λ = λ0 + L i, [`RingLoad::commit`] takes
//! the current and finishes the field.

pub mod nodes;
mod state;
mod step;

use pulp::Arch;

use self::nodes::{FoilAndBase, NodeCoefficients, OneMetal};
pub use self::state::{FluxLine, RingLoad};
use self::state::{History, Surface};
use self::step::{Commit, Predict};
use super::error::FieldError;
use super::model::Rings;
use super::profile::Metals;

impl<const N: usize> RingLoad<N> {
    /// Creates an unmagnetised load of one metal that is stepped with `dt_s` seconds. The model must have `N` rings.
    ///
    /// # Errors
    /// [`FieldError`] of the step, the metal or the number of rings.
    pub fn new(model: &Rings, dt_s: f64) -> Result<Self, FieldError> {
        Self::with_nodes(model, dt_s, OneMetal::new)
    }
}

impl<const N: usize> RingLoad<N, FoilAndBase<N>> {
    /// The same for a load with a foil.
    ///
    /// # Errors
    /// [`FieldError`] of the step, the metals or the number of rings.
    pub fn with_foil(model: &Rings, dt_s: f64) -> Result<Self, FieldError> {
        Self::with_nodes(model, dt_s, FoilAndBase::new)
    }
}

impl<const N: usize, C: NodeCoefficients<N>> RingLoad<N, C> {
    fn with_nodes(
        model: &Rings,
        dt_s: f64,
        coefficients: fn(&Rings, f64) -> Result<C, FieldError>,
    ) -> Result<Self, FieldError> {
        super::error::in_range("dt_s", dt_s, 1e-10, 1e-6, "0.1 ns to 1 µs")?;
        let rings = |v: &[f64]| -> Result<[f64; N], FieldError> {
            v.try_into().map_err(|_| FieldError::OutOfRange {
                field: "rings",
                value: v.len() as f64,
                allowed: "the ring count the time-domain model was compiled for",
            })
        };
        let nodes = model.profiles[0].depth.nodes();
        let zeros = || History {
            now: vec![[0.0; N]; nodes],
            before: vec![[0.0; N]; nodes],
        };
        let p = rings(&model.gap.p_m)?;
        let mut s = [[0.0; N]; N];
        for (row, values) in s.iter_mut().zip(model.gap.s.chunks(N)) {
            *row = rings(values)?;
        }
        Ok(Self {
            arch: Arch::new(),
            nodes: coefficients(model, dt_s)?,
            l0_h: model.gap.l0_h,
            p,
            w: rings(&model.gap.w_m2)?,
            s,
            h: zeros(),
            b: zeros(),
            a_inner: History {
                now: [0.0; N],
                before: [0.0; N],
            },
            e: vec![[0.0; N]; nodes],
            f: vec![[0.0; N]; nodes],
            slope: vec![[0.0; N]; nodes],
            offset: vec![[0.0; N]; nodes],
            surface: Surface {
                a0: [0.0; N],
                a1: [0.0; N],
                base: [0.0; N],
                gain: [0.0; N],
                inner_base: [0.0; N],
            },
        })
    }

    /// Changes the time step, in second; the next step treats the old instants as if they had the new distance. For steps within
    /// a percent of each other, as a change of the switching frequency makes them.
    ///
    /// # Errors
    /// [`FieldError::OutOfRange`].
    pub fn set_dt(&mut self, dt_s: f64) -> Result<(), FieldError> {
        super::error::in_range("dt_s", dt_s, 1e-10, 1e-6, "0.1 ns to 1 µs")?;
        self.nodes.set_dt(dt_s);
        Ok(())
    }

    /// Changes the metals, as a slow change of temperature does; the field strength stays.
    ///
    /// # Errors
    /// [`FieldError`] of a metal.
    pub fn set_metals(&mut self, metals: &Metals) -> Result<(), FieldError> {
        metals.base.check()?;
        metals.foil.check()?;
        self.nodes.set_metals(metals)
    }

    /// Relation between flux linkage and current at the next instant.
    pub fn predict(&mut self) -> FluxLine {
        self.arch.dispatch(Predict(self))
    }

    /// Finishes the step with the current (ampere) that the circuit found.
    pub fn commit(&mut self, i_a: f64) {
        self.arch.dispatch(Commit(self, i_a));
    }

    /// One more Newton step for the same instant: the tangent at the field that `trial`, a copy
    /// of this load, reached when it was committed.
    #[cfg(test)]
    pub(crate) fn predict_again(&mut self, trial: &Self) -> FluxLine {
        for n in 0..trial.h.now.len() {
            self.tangent(n, &trial.h.now[n]);
        }
        self.eliminate();
        self.couple()
    }

    /// Heat developed in the load at the last instant, in watt: ∫ J²/σ.
    #[cfg(test)]
    fn loss_w(&self) -> f64 {
        let nodes = self.h.now.len();
        let mut sum = 0.0;
        for j in 0..N {
            let mut ring = 0.0;
            for n in 0..nodes {
                let below = if n + 1 < nodes {
                    self.h.now[n + 1][j]
                } else {
                    0.0
                };
                let step = self.h.now[n][j] - below;
                ring += step * step * self.nodes.conductance(n)[j];
            }
            sum += self.w[j] * ring;
        }
        sum * self.nodes.loss_unit()
    }
}

#[cfg(test)]
mod tests {
    use super::super::harmonic;
    use super::super::material::{Knee, Material};
    use super::super::model::{FieldModel, FieldSettings};
    use super::super::tank::ImpressedCurrent;
    use super::*;

    fn model() -> Rings {
        Rings::new(&FieldSettings::paper()).unwrap()
    }

    /// Current of 30 A amplitude at 45 kHz with a third harmonic, as a bridge gives.
    fn current_a(k: usize) -> f64 {
        let angle = 2.0 * core::f64::consts::PI * 45e3 * 20e-9 * k as f64;
        30.0 * libm::sin(angle) + 4.0 * libm::sin(3.0 * angle)
    }

    #[test]
    fn one_newton_step_is_enough() {
        let mut once = RingLoad::<16>::new(&model(), 20e-9).unwrap();
        let mut twice = once.clone();
        let (mut worst, mut peak) = (0.0f64, 0.0f64);
        for k in 1..3000 {
            let i = current_a(k);
            let a = once.predict();
            once.commit(i);
            twice.predict();
            let mut trial = twice.clone();
            trial.commit(i);
            let b = twice.predict_again(&trial);
            twice.commit(i);
            let (a, b) = (a.lambda0_wb + a.l_h * i, b.lambda0_wb + b.l_h * i);
            worst = worst.max((a - b).abs());
            peak = peak.max(b.abs());
        }
        println!("Newton remainder {:e} of the peak flux", worst / peak);
        assert!(worst < 1e-5 * peak, "{:e}", worst / peak);
    }

    /// Waveform of the other laws against their describing function: equal at no current, and at 30 A as different as
    /// Fröhlich's.
    #[test]
    fn other_laws_diffuse_as_their_describing_function_says() {
        for (knee, tail_mu_r) in [(Knee::Froehlich, 10.0), (Knee::Sharp, 0.0)] {
            let mut settings = FieldSettings::paper();
            settings.material = Material::Saturating {
                knee,
                alpha_a_per_m: 1500.0,
                b_per_t: 0.5,
                tail_mu_r,
                sigma_s_per_m: 8e6,
            };
            let model = FieldModel::new(&settings).unwrap();
            for (i_a, r_off, l_off) in [(1e-3, 4e-3, 2e-3), (30.0, 0.05, 0.03)] {
                let sine = harmonic::impedance(&model, 45e3, i_a).unwrap();
                let (r, l) =
                    ImpressedCurrent::<16>::fundamental(&model, 45e3, i_a, 1000, 6).unwrap();
                println!("{knee:?} {i_a} A: {r} {l}, {sine:?}");
                assert!((r / sine.r_ohm - 1.0).abs() < r_off);
                assert!((l / sine.l_h - 1.0).abs() < l_off);
            }
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_digits() {
        let mut fast = RingLoad::<16>::new(&model(), 20e-9).unwrap();
        let mut scalar = fast.clone();
        scalar.arch = Arch::Scalar;
        for k in 1..500 {
            let i = current_a(k);
            assert_eq!(fast.predict(), scalar.predict(), "step {k}");
            fast.commit(i);
            scalar.commit(i);
        }
        assert_eq!(fast.h.now, scalar.h.now);
    }

    #[test]
    fn heat_in_the_load_is_the_electric_power() {
        // The second 10 000 steps of 20 ns: nine periods.
        let mut load = RingLoad::<16>::new(&model(), 20e-9).unwrap();
        let (mut lambda, mut before) = (0.0, 0.0);
        let (mut electric, mut heat) = (0.0, 0.0);
        for k in 1..=20_000 {
            let i = current_a(k);
            let line = load.predict();
            load.commit(i);
            let new = line.lambda0_wb + line.l_h * i;
            if k > 10_000 {
                electric += i * (1.5 * new - 2.0 * lambda + 0.5 * before) / 20e-9;
                heat += load.loss_w();
            }
            (before, lambda) = (lambda, new);
        }
        println!("electric {electric}, heat {heat}");
        assert!((electric / heat - 1.0).abs() < 2e-3, "{electric} {heat}");
    }

    #[test]
    fn a_law_whose_flux_density_falls_is_refused() {
        let mut s = FieldSettings::paper();
        s.material = Material::PAPER_LITERAL;
        let refused = RingLoad::<16>::new(&Rings::new(&s).unwrap(), 20e-9).unwrap_err();
        assert_eq!(refused, FieldError::NoTimeDomain);
    }

    #[test]
    fn a_model_with_another_ring_count_is_refused() {
        let mut s = FieldSettings::paper();
        s.rings = 32;
        let e = RingLoad::<16>::new(&Rings::new(&s).unwrap(), 20e-9).unwrap_err();
        assert!(e.to_string().contains("rings"));
    }
}
