//! The hybrid-timescale PINN of `ihd_pinn`, half-cycle by half-cycle.

use ihd_signal::Segment;
use serde::{Deserialize, Serialize};

use super::{Estimate, IdentifyError, Settings, Watch};

/// What of the network may be chosen; words, so that they mean the same in a build without it.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PinnSettings {
    /// Preset, such as `hybrid`, `paper-literal` or `paper-repaired`; `hybrid` if not given.
    pub preset: Option<String>,
    /// `fused` or `ndarray`; the preset's if not given.
    pub backend: Option<String>,
    /// No wall-clock limit, so that two runs give the same digits.
    pub deterministic: bool,
    /// Any other setting of `ihd_pinn::Config` by its name.
    pub config: toml::Table,
    /// The carrier of the segment, where it moves.
    #[serde(skip)]
    pub carrier: Option<CarrierInputs>,
}

/// What the network is told of a carrier that moves, on the segment's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct CarrierInputs {
    /// Time of the first value in seconds.
    pub t0_s: f64,
    /// Time from one value to the next in seconds.
    pub dt_s: f64,
    /// How far the frequency is from its mean, and how fast it moves, each within about -1..=1.
    pub functions: Vec<Vec<f64>>,
    /// Spline intervals of the phasors in a mains half-cycle.
    pub intervals: usize,
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
    /// Nothing to check: [`identify`] refuses.
    ///
    /// # Errors
    /// None.
    pub fn check(&self) -> Result<(), IdentifyError> {
        Ok(())
    }
}

#[cfg(feature = "pinn")]
impl PinnSettings {
    /// The network's configuration.
    fn resolve(&self) -> Result<ihd_pinn::Config, ihd_pinn::PinnError> {
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
        ihd_pinn::Config::from_toml(&table.to_string())
    }

    /// Whether all names and numbers mean something, before a capture is looked at.
    ///
    /// # Errors
    /// [`IdentifyError::Unfit`] with the names that there are, or the range.
    pub fn check(&self) -> Result<(), IdentifyError> {
        self.resolve().map(drop).map_err(unfit)
    }
}

/// Trains the network on each mains half-cycle of the segment.
///
/// # Errors
/// [`IdentifyError::NotInThisBuild`] without the feature `pinn`.
#[cfg(not(feature = "pinn"))]
pub fn identify(_: &Segment, _: &Settings, _: &mut Watch<'_>) -> Result<Estimate, IdentifyError> {
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
/// [`IdentifyError::Unfit`] with what the network reports.
#[cfg(feature = "pinn")]
pub fn identify(
    segment: &Segment,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Estimate, IdentifyError> {
    use std::time::Instant;

    use ihd_signal::SegmentError;
    use ihd_signal::segment::MIN_PERIODS;

    use super::{Method, network};

    let started = Instant::now();
    let mut config = network::informed(settings.pinn.resolve().map_err(unfit)?, segment);
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    let least = MIN_PERIODS * segment.samples_per_period();
    for (from, to) in segment.half_cycles() {
        if ((to - from) as f64) < least {
            continue;
        }
        if let Some(carrier) = &settings.pinn.carrier {
            network::follow(&mut config, carrier, segment.crossing_of_s((from, to)));
        }
        network::half_cycle(segment, (from, to), &config, None, watch, &mut estimate)
            .map_err(unfit)?;
    }
    if estimate.t_s.is_empty() {
        return Err(SegmentError::TooShort {
            periods: segment.len() as f64 / segment.samples_per_period(),
            needed: MIN_PERIODS,
        }
        .into());
    }
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}
