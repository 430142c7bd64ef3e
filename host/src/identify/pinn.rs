//! The hybrid-timescale PINN of `ihd_pinn`, half-cycle by half-cycle.

use serde::{Deserialize, Serialize};

use super::{Estimate, IdentifyError, Segment, Settings, Watch};

/// What of the network may be chosen; words, so that they mean the same in a build without it.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PinnSettings {
    /// Preset, such as `hybrid`, `paper-literal` or `paper-repaired`; `hybrid` if not given.
    pub preset: Option<String>,
    /// `fused`, `flex` or `ndarray`; the preset's if not given.
    pub backend: Option<String>,
    /// No wall-clock limit, so that two runs give the same digits.
    pub deterministic: bool,
    /// Any other setting of `ihd_pinn::Config` by its name.
    pub config: toml::Table,
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

/// Trains the network on each mains half-cycle of the segment.
///
/// # Errors
/// [`IdentifyError::Unfit`] with what the network says.
#[cfg(feature = "pinn")]
pub fn identify(
    segment: &Segment,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Estimate, IdentifyError> {
    use std::time::Instant;

    use ihd_pinn::Waveform;

    use super::Method;
    use super::noise::WhiteNoise;
    use super::segment::MIN_PERIODS;

    let started = Instant::now();
    let unfit = |e: ihd_pinn::PinnError| IdentifyError::Unfit {
        method: Method::Pinn,
        why: e.to_string(),
    };
    let mut config = settings.pinn.resolve().map_err(unfit)?;
    config.noise = config.noise.or(WhiteNoise::measure(segment).told());
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    let least = MIN_PERIODS * segment.samples_per_period();
    for (from, to) in segment.half_cycles() {
        if ((to - from) as f64) < least {
            continue;
        }
        let t0_s = segment.t_s(from);
        let crossing_s = segment.crossing_of_s((from, to));
        let window = Waveform {
            f_sw_hz: segment.f_sw_hz,
            f_mains_hz: segment.mains_hz,
            t0_s: t0_s - crossing_s,
            dt_s: segment.dt_s,
            v_volt: &segment.v_v[from..to],
            i_ampere: &segment.i_a[from..to],
        };
        let truth_at = |t_s: f64| {
            let at = watch.truth.and_then(|truth| truth.at(t_s + crossing_s));
            at.unwrap_or((f64::NAN, f64::NAN))
        };
        let task = ihd_pinn::Task {
            window,
            config: &config,
            truth: watch.truth.map(|_| &truth_at as ihd_pinn::TruthAt<'_>),
            checkpoint: None,
        };
        let found = task.run(&mut |p| (watch.say)(progress(p))).map_err(unfit)?;
        estimate.notes.push(format!(
            "half-cycle from {crossing_s:.4} s: {} steps, {}; {}",
            found.iterations,
            found.stopped_because,
            physics(&found)
        ));
        estimate
            .t_s
            .extend(found.t_s.iter().map(|t| t + crossing_s));
        estimate.r_ohm.extend(found.r_ohm);
        estimate.l_h.extend(found.l_h);
        estimate.r_sigma_ohm.extend(found.r_sigma_ohm);
        estimate.l_sigma_h.extend(found.l_sigma_h);
        estimate.r_power_ohm.extend(found.r_power_ohm);
    }
    if estimate.t_s.is_empty() {
        return Err(IdentifyError::TooShort {
            periods: segment.len() as f64 / segment.samples_per_period(),
            needed: MIN_PERIODS,
        });
    }
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}

/// A training's state in words; where the truth is known, the errors of R and L too.
#[cfg(feature = "pinn")]
pub fn progress(p: &ihd_pinn::Progress) -> String {
    let (step, l_f, l_i) = (p.iteration, p.l_f, p.l_i);
    let errors = p
        .mre_pct
        .map_or(String::new(), |(r, l)| format!(", off {r:.2}/{l:.2} %"));
    format!("step {step}, L_f {l_f:.1e}, L_i {l_i:.1e}{errors}")
}

/// P/I_rms² at the crest beside R of the fundamental, and the order of the impedance law.
#[cfg(feature = "pinn")]
fn physics(found: &ihd_pinn::Identified) -> String {
    let largest = |a: &usize, b: &usize| {
        let i = &found.i_amplitude_a;
        i[*a].total_cmp(&i[*b])
    };
    let crest = (0..found.i_amplitude_a.len()).max_by(largest).unwrap_or(0);
    let (r, p) = (found.r_ohm[crest], found.r_power_ohm[crest]);
    let order = match found.impedance_order {
        0.0 => String::new(),
        n => format!(", impedance order {n:.2}"),
    };
    format!("at the crest R {r:.3} Ω, P/I_rms² {p:.3} Ω{order}")
}
