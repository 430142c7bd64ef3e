//! Coil and load in time.

use super::diffusion::nodes::FoilAndBase;
use super::diffusion::{FluxLine, RingLoad};
use super::error::{FieldError, in_range};
use super::harmonic;
use super::material::Material;
use super::model::{Body, FieldModel};
use super::modes::{MODES, Modes};
use super::profile::Metals;

/// Load that is stepped through time with the circuit; a saturating one has `N` rings.
#[derive(Clone, Debug)]
pub enum FieldLoad<const N: usize> {
    /// A metal that saturates.
    Rings {
        /// Rings.
        load: Box<RingLoad<N>>,
        /// Resistance of the shield in ohm.
        shield_r_ohm: f64,
    },
    /// A foil that saturates, below a base.
    Foil {
        /// Rings.
        load: Box<RingLoad<N, FoilAndBase<N>>>,
        /// Resistance of the shield in ohm.
        shield_r_ohm: f64,
    },
    /// A linear metal.
    Modes(Box<ModeLoad>),
}

impl<const N: usize> FieldLoad<N> {
    /// Creates a load without field that is stepped with `dt_s` seconds.
    ///
    /// # Errors
    /// [`FieldError::OutOfRange`] of the step, or of rings that are not `N`.
    pub fn new(model: &FieldModel, dt_s: f64) -> Result<Self, FieldError> {
        Ok(match &model.body {
            Body::Rings(rings) if rings.profiles.len() > 1 => Self::Foil {
                load: Box::new(RingLoad::with_foil(rings, dt_s)?),
                shield_r_ohm: harmonic::shield_r_ohm(rings)?,
            },
            Body::Rings(rings) => Self::Rings {
                load: Box::new(RingLoad::new(rings, dt_s)?),
                shield_r_ohm: harmonic::shield_r_ohm(rings)?,
            },
            Body::Modes(modes) => Self::Modes(Box::new(ModeLoad::new(modes, dt_s)?)),
        })
    }

    /// Changes the time step, in second; the next step treats the old instants as if they had the new distance. For steps within
    /// a percent of each other, as a change of the switching frequency makes them.
    ///
    /// # Errors
    /// [`FieldError::OutOfRange`].
    pub fn set_dt(&mut self, dt_s: f64) -> Result<(), FieldError> {
        match self {
            Self::Rings { load, .. } => load.set_dt(dt_s),
            Self::Foil { load, .. } => load.set_dt(dt_s),
            Self::Modes(load) => load.set_dt(dt_s),
        }
    }

    /// Changes the metals, as a slow change of temperature does; the field strength stays.
    ///
    /// # Errors
    /// [`FieldError`] of a metal.
    pub fn set_metals(&mut self, metals: &Metals) -> Result<(), FieldError> {
        match self {
            Self::Rings { load, .. } => load.set_metals(metals),
            Self::Foil { load, .. } => load.set_metals(metals),
            Self::Modes(load) => load.set_material(&metals.base),
        }
    }

    /// Resistance in series with the flux linkage's voltage, in ohm: the shield's, where λ does not hold it.
    pub fn shield_r_ohm(&self) -> f64 {
        match self {
            Self::Rings { shield_r_ohm, .. } | Self::Foil { shield_r_ohm, .. } => *shield_r_ohm,
            Self::Modes(_) => 0.0,
        }
    }

    /// Relation between flux linkage and current at the next instant.
    pub fn predict(&mut self) -> FluxLine {
        match self {
            Self::Rings { load, .. } => load.predict(),
            Self::Foil { load, .. } => load.predict(),
            Self::Modes(load) => load.predict(),
        }
    }

    /// Finishes the step with the current (ampere) that the circuit found.
    pub fn commit(&mut self, i_a: f64) {
        match self {
            Self::Rings { load, .. } => load.commit(i_a),
            Self::Foil { load, .. } => load.commit(i_a),
            Self::Modes(load) => load.commit(i_a),
        }
    }
}

/// Relaxations x + τ dx/dt = L i in steps of second-order backward differences.
#[derive(Clone, Debug)]
pub struct ModeLoad {
    modes: Modes,
    dt_s: f64,
    /// x at the last instant and the one before, in weber.
    now: [f64; MODES],
    before: [f64; MODES],
    /// x at the next instant = offset + gain i.
    offset: [f64; MODES],
    gain: [f64; MODES],
}

impl ModeLoad {
    /// Creates a load without field.
    ///
    /// # Errors
    /// [`FieldError::OutOfRange`] of the step.
    pub fn new(modes: &Modes, dt_s: f64) -> Result<Self, FieldError> {
        let mut load = Self {
            modes: modes.clone(),
            dt_s,
            now: [0.0; MODES],
            before: [0.0; MODES],
            offset: [0.0; MODES],
            gain: [0.0; MODES],
        };
        load.set_dt(dt_s)?;
        Ok(load)
    }

    fn set_dt(&mut self, dt_s: f64) -> Result<(), FieldError> {
        in_range("dt_s", dt_s, 1e-10, 1e-6, "0.1 ns to 1 µs")?;
        self.dt_s = dt_s;
        Ok(())
    }

    /// Another conductivity stretches all relaxations, the shield's too.
    fn set_material(&mut self, material: &Material) -> Result<(), FieldError> {
        material.check()?;
        self.modes.set_sigma(material.sigma_s_per_m());
        Ok(())
    }

    fn predict(&mut self) -> FluxLine {
        let mut line = FluxLine {
            lambda0_wb: 0.0,
            l_h: 0.0,
        };
        for k in 0..MODES {
            let rate = self.modes.tau_s[k] / self.dt_s;
            let share = 1.0 / (1.0 + 1.5 * rate);
            self.offset[k] = share * rate * (2.0 * self.now[k] - 0.5 * self.before[k]);
            self.gain[k] = share * self.modes.l_h[k];
            line.lambda0_wb += self.offset[k];
            line.l_h += self.gain[k];
        }
        line
    }

    fn commit(&mut self, i_a: f64) {
        self.before = self.now;
        for k in 0..MODES {
            self.now[k] = self.offset[k] + self.gain[k] * i_a;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::FieldSettings;
    use crate::tank::ImpressedCurrent;

    #[test]
    fn a_linear_metal_has_in_time_the_impedance_that_it_has_in_frequency() {
        let mut settings = FieldSettings::paper();
        settings.material = Material::ALUMINIUM;
        settings.geometry.load_radius_m = 0.06;
        let model = FieldModel::new(&settings).unwrap();
        let sine = harmonic::impedance(&model, 45e3, 5.0).unwrap();
        // The slowest relaxation takes 0.4 ms: 18 periods.
        let (r_ohm, l_h) =
            ImpressedCurrent::<16>::fundamental(&model, 45e3, 5.0, 1000, 150).unwrap();
        assert!((r_ohm / sine.r_ohm - 1.0).abs() < 3e-3, "{r_ohm} {sine:?}");
        assert!((l_h / sine.l_h - 1.0).abs() < 1e-4, "{l_h} {sine:?}");
    }

    /// A foil of 0.3 mm is thinner than its saturated skin is deep; 120 mm lose much at its edge.
    #[test]
    fn a_foil_has_in_time_the_impedance_that_it_has_in_frequency() {
        let mut settings = FieldSettings::paper();
        settings.material = Material::ALUMINIUM;
        settings.geometry.foil_thickness_m = 0.3e-3;
        settings.geometry.load_radius_m = 0.06;
        let model = FieldModel::new(&settings).unwrap();
        for (i_a, r_off, l_off) in [(1e-3, 4e-3, 2e-3), (30.0, 0.05, 0.03)] {
            let sine = harmonic::impedance(&model, 45e3, i_a).unwrap();
            let (r_ohm, l_h) =
                ImpressedCurrent::<16>::fundamental(&model, 45e3, i_a, 1000, 12).unwrap();
            println!("{i_a} A: {r_ohm} {l_h}, {sine:?}");
            assert!((r_ohm / sine.r_ohm - 1.0).abs() < r_off, "{r_ohm} {sine:?}");
            assert!((l_h / sine.l_h - 1.0).abs() < l_off, "{l_h} {sine:?}");
        }
    }
}
