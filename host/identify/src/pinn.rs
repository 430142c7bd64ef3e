//! Estimator by the hybrid-timescale PINN of `ihd_pinn`, half-cycle by half-cycle.

use ihd_signal::Segment;
use serde::{Deserialize, Serialize};

use super::carrier_inputs::CarrierInputs;
use super::{Estimate, IdentifyError, IdentifyOptions, ProgressSink};

/// Options of the network, as texts that are valid in a build without it, too.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PinnSettings {
    /// Preset, such as `hybrid`, `paper-literal` or `paper-repaired`; `hybrid` if not given.
    pub preset: Option<String>,
    /// `fused` or `ndarray`; the preset's if not given.
    pub backend: Option<String>,
    /// Set for no wall-clock limit, so that two runs give the same digits.
    pub deterministic: bool,
    /// Any other setting of `ihd_pinn::PinnConfig` by its name.
    pub config: toml::Table,
    /// Carrier of the segment; `None` if its frequency is constant.
    #[serde(skip)]
    pub carrier: Option<CarrierInputs>,
}

/// Names of the network's presets, with commas between them.
#[cfg(feature = "pinn")]
pub fn preset_names() -> String {
    ihd_pinn::PresetLibrary::default().names().join(", ")
}

/// Names of the network's presets, with commas between them.
#[cfg(not(feature = "pinn"))]
pub fn preset_names() -> String {
    "none in this build".to_owned()
}

#[cfg(not(feature = "pinn"))]
impl PinnSettings {
    /// Accepts all options, because [`identify`] fails in this build.
    ///
    /// # Errors
    /// None.
    pub fn check(&self) -> Result<(), IdentifyError> {
        Ok(())
    }
}

#[cfg(feature = "pinn")]
impl PinnSettings {
    /// Configuration of the network.
    fn resolve(&self) -> Result<ihd_pinn::PinnConfig, ihd_pinn::PinnError> {
        let mut table = self.config.clone();
        if let Some(preset) = &self.preset {
            table.insert("preset".into(), preset.clone().into());
        }
        if let Some(backend) = &self.backend {
            table.insert("backend".into(), backend.clone().into());
        }
        if self.deterministic {
            table.insert("deterministic".into(), true.into());
        }
        ihd_pinn::PinnConfig::from_toml(&table.to_string())
    }

    /// Checks all names and numbers, before a capture is read.
    ///
    /// # Errors
    /// [`IdentifyError::Unfit`] with the valid names, or the range.
    pub fn check(&self) -> Result<(), IdentifyError> {
        self.resolve().map(drop).map_err(unfit)
    }
}

/// Trains the network on each mains half-cycle of the segment.
///
/// # Errors
/// [`IdentifyError::NotInThisBuild`] without the feature `pinn`.
#[cfg(not(feature = "pinn"))]
pub fn identify(
    _: &Segment,
    _: &IdentifyOptions,
    _: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    Err(IdentifyError::NotInThisBuild {
        method: super::Method::Pinn,
        feature: "pinn",
    })
}

#[cfg(feature = "pinn")]
fn unfit(e: ihd_pinn::PinnError) -> IdentifyError {
    IdentifyError::Unfit {
        method: super::Method::Pinn,
        why: e.to_string(),
    }
}

/// Trains the network on each mains half-cycle of the segment.
///
/// # Errors
/// [`IdentifyError::Unfit`] with the network's error.
#[cfg(feature = "pinn")]
pub fn identify(
    segment: &Segment,
    settings: &IdentifyOptions,
    sink: &mut ProgressSink<'_>,
) -> Result<Estimate, IdentifyError> {
    use std::time::Instant;

    use ihd_signal::segment::MIN_PERIODS;

    use super::{Method, network};

    let started = Instant::now();
    let mut config = network::with_measured_noise(settings.pinn.resolve().map_err(unfit)?, segment);
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    let least = MIN_PERIODS * segment.samples_per_period();
    for (from, to) in segment.half_cycles() {
        if ((to - from) as f64) < least {
            continue;
        }
        if let Some(carrier) = &settings.pinn.carrier {
            network::follow_carrier(&mut config, carrier, segment.crossing_of_s((from, to)));
        }
        network::identify_half_cycle(segment, (from, to), &config, None, sink, &mut estimate)
            .map_err(unfit)?;
    }
    if estimate.t_s.is_empty() {
        return Err(segment.too_short(MIN_PERIODS).into());
    }
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}
