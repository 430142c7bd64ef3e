//! Tones in the coil voltage that this hob does not make: another hob's coil beside it, or an edge that aliases next to
//! the carrier. Those near the carrier are fitted together with a static load ([`crate::joint`]), the others found in the spectrum
//! of what that load leaves. The cost of a tone is measured: least squares with it against least squares without it.

mod residual;
mod tone;

use ihd_identify::Estimate;
use ihd_identify::lockin::demodulate;
use ihd_identify::pooled::{self, PoolPhasors};
use ihd_signal::carrier::Carrier;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};

use residual::Residual;
pub use tone::{Tone, remove_tones};

use crate::comparison;
use crate::joint::{Cause, JointFit};
use crate::limits::{INFO_SHARE, TOLERABLE_PCT, WARNING_SHARE};

/// Most phasors that are searched together, because a tone need not last longer.
const MAX_PHASORS: usize = 8192;

/// Switching periods of the boxcar that confirms a tone: a tone seen by one boxcar only is that boxcar's artefact.
const CHECK_PERIODS: f64 = 5.0;

/// Disturbances of a segment.
#[derive(Clone, Debug, Default)]
pub struct Interference {
    /// Tones beside the carrier.
    pub tones: Vec<Tone>,
    /// Fit of a static load, part by part; those parts without enough phasors are left out.
    pub fits: Vec<JointFit>,
    /// Phasors in which all of this was found, to be pooled; `None` if there are too few, or the frequency moves.
    pub phasors: Option<PoolPhasors>,
}

impl Interference {
    /// Tones of other hobs, which can be removed; an alias is in both channels.
    pub fn neighbours(&self) -> impl Iterator<Item = &Tone> {
        self.tones.iter().filter(|tone| !tone.alias)
    }

    /// Time in seconds, from the segment's first sample, at which the load steps; `None` if it does not.
    fn step_s(&self) -> Option<f64> {
        self.fits.iter().find_map(|f| match f.cause {
            Cause::Step(t_s) => Some(t_s),
            _ => None,
        })
    }

    /// Warning that R and L are not functions of the current alone, and that no tone explains it; else `None`.
    pub fn law_remark(&self, segment: &Segment) -> Option<Remark> {
        if let Some(step_s) = self.step_s() {
            let t_s = segment.t0_s + step_s;
            let text = format!(
                "the load steps near {:.1} ms: before and after R and L are functions of the current, but not the same ones",
                t_s * 1e3
            );
            return Some(Remark::new("load_step", Severity::Warning, text).with(t_s, None));
        }
        let unexplained = |f: &&JointFit| matches!(f.cause, Cause::Drift | Cause::Unknown);
        let share = |f: &JointFit| {
            (f.misfit_pct[0] / TOLERABLE_PCT[0]).max(f.misfit_pct[1] / TOLERABLE_PCT[1])
        };
        let all = self.fits.iter().filter(unexplained);
        let worst = all.max_by(|a, b| share(a).total_cmp(&share(b)))?;
        let [r_pct, l_pct] = worst.misfit_pct;
        let slowest_hz = 1.0 / (segment.len() as f64 * segment.dt_s);
        let why = match worst.cause {
            Cause::Drift => format!(
                "they drift: the pot moves, or another hob switches within {slowest_hz:.0} Hz of this one"
            ),
            _ => format!(
                "the load steps or moves, the mains is not the one of {:.2} Hz that is used, or something that is no tone disturbs the voltage",
                segment.mains_hz
            ),
        };
        let text = format!(
            "R and L are not functions of the current alone, by {r_pct:.1} and {l_pct:.1} %; {why}"
        );
        let worse = usize::from(l_pct / TOLERABLE_PCT[1] > r_pct / TOLERABLE_PCT[0]);
        let remark = Remark::new("load_moves", Severity::Warning, text);
        Some(remark.with(
            worst.misfit_pct[worse],
            Some(crate::joint::MISFIT_PCT[worse]),
        ))
    }
}

/// Remark on tones, from least squares with and without them; `None` if they cost nothing. Tones that were removed are no
/// error any more.
pub fn remark(
    segment: &Segment,
    tones: &[Tone],
    reference: &Estimate,
    cleaned: &Estimate,
    removed: bool,
) -> Option<Remark> {
    let strongest = tones
        .iter()
        .max_by(|a, b| a.v.norm().total_cmp(&b.v.norm()))?;
    let costs = comparison::differences(segment, reference, cleaned);
    let cost = costs
        .into_iter()
        .max_by(|a, b| a.share().total_cmp(&b.share()))?;
    // The share that windows shorter than those of least squares would see; an alias is not in the coil's voltage.
    let may_cost_pct = if strongest.alias {
        0.0
    } else {
        strongest.may_cost_pct
    };
    let severity = match cost.share() {
        s if s > 1.0 && !removed => Severity::Error,
        s if s.max(may_cost_pct / TOLERABLE_PCT[0]) > WARNING_SHARE => Severity::Warning,
        s if s > INFO_SHARE => Severity::Info,
        _ => return None,
    };
    let text = format!(
        "a tone of {:.1} V lies {:+.3} kHz beside the switching frequency, at {:.2} kHz: it costs {:.1} % of R and \
         {:.1} % of L; {}",
        strongest.v.norm(),
        strongest.offset_hz * 1e-3,
        (segment.f_sw_hz + strongest.offset_hz) * 1e-3,
        cost.mean_pct[0],
        cost.mean_pct[1],
        match (strongest.alias, removed) {
            (true, _) => "it is an alias of the inverter's edges: sample at another rate",
            (false, false) => "switch the coil beside this one off",
            (false, true) if severity == Severity::Info => "it was removed",
            (false, true) =>
                "it was removed, and the sensors were not calibrated; better switch the coil beside this one off",
        }
    );
    let worse =
        usize::from(cost.mean_pct[1] / TOLERABLE_PCT[1] > cost.mean_pct[0] / TOLERABLE_PCT[0]);
    let remark = Remark::new("interference", severity, text);
    Some(remark.with(cost.mean_pct[worse], Some(TOLERABLE_PCT[worse])))
}

/// Searches for tones, and checks whether R and L are functions of the current alone; `noise` is the segment's.
pub fn find(segment: &Segment, noise: WhiteNoise) -> Interference {
    let mut found = Interference::default();
    let boxcar = pooled::boxcar(segment);
    let phasors = demodulate(segment, boxcar);
    let Some(mut residual) = Residual::from_phasors(segment, boxcar, &phasors) else {
        return found;
    };
    found.phasors = Some(PoolPhasors::from_phasors(segment, noise, &phasors));
    let volt_per_pct = residual.volt_per_pct();
    found.fits = residual.joint_fits(noise, volt_per_pct, &mut found.tones);
    if !found.tones.is_empty() || !found.fits.iter().all(|f| matches!(f.cause, Cause::None)) {
        // A frequency that moves changes R and L; it is followed elsewhere.
        if Carrier::from_segment(segment).is_some_and(|carrier| carrier.moves()) {
            return Interference::default();
        }
    }
    residual.subtract(&found.tones);
    let step_s = found.step_s();
    if let Some(step_s) = step_s {
        residual.split(step_s);
    }
    let aliases = aliases_hz(segment);
    let chunks = residual.len().div_ceil(MAX_PHASORS).max(1);
    let length = residual.len() / chunks;
    let mut far: Vec<Tone> = (0..chunks)
        .flat_map(|k| {
            residual.tones(
                k * length..(k + 1) * length,
                volt_per_pct,
                &aliases,
                segment,
            )
        })
        .collect();
    if !far.is_empty() {
        let mut check = Residual::demodulate(segment, CHECK_PERIODS);
        if let Some(check) = &mut check {
            check.subtract(&found.tones);
            if let Some(step_s) = step_s {
                check.split(step_s);
            }
        }
        far.retain(|tone| check.as_ref().is_some_and(|check| check.confirms(tone)));
    }
    found.tones.extend(far);
    found
}

/// Frequencies beside the carrier to which harmonics beyond half the sampling rate fold, in hertz from the carrier.
fn aliases_hz(segment: &Segment) -> Vec<f64> {
    let rate_hz = 1.0 / segment.dt_s;
    let most = (3.0 * segment.samples_per_period()).min(400.0) as usize;
    let folded = |h: usize| {
        let hz = h as f64 * segment.f_sw_hz;
        (hz - (hz / rate_hz).round() * rate_hz).abs() - segment.f_sw_hz
    };
    (2..=most).map(folded).collect()
}

/// Samples per switching period below which edges of 0.2 µs have strong harmonics beyond half the sampling rate.
const COARSE_SAMPLES_PER_PERIOD: f64 = 150.0;

/// Offset in hertz up to which the lock-in's boxcars of 0.1 ms let a tone through.
const LOCKIN_HZ: f64 = 10e3;

/// Returns `true` if a harmonic of the edges folds to a frequency that the lock-in passes and least squares does not: then
/// the error is the lock-in's.
pub fn disturbs_lockin(segment: &Segment) -> bool {
    let passed = |hz: &f64| (FOLLOWED_HZ..LOCKIN_HZ).contains(&hz.abs());
    segment.samples_per_period() < COARSE_SAMPLES_PER_PERIOD
        && aliases_hz(segment).iter().any(passed)
}

/// Offset in hertz up to which least squares follows a tone: half a wave in each of its intervals of 0.4 ms.
const FOLLOWED_HZ: f64 = 1.2e3;

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use ihd_identify::{IdentifyOptions, Method, run};

    use super::*;

    const OMEGA: f64 = TAU * 45e3;

    /// Two half-cycles through 3 Ω and 18 µH, with a tone in the voltage and white noise of 50 dB.
    fn segment(offset_hz: f64, v: f64) -> Segment {
        let dt_s = 80e-9;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut noise = |sigma: f64| -> f64 {
            let x: f64 = StandardNormal.sample(&mut rng);
            sigma * x
        };
        let (mut v_v, mut i_a) = (Vec::new(), Vec::new());
        for k in 0..250_000 {
            let t = f64::from(k) * dt_s;
            let (mains, turn) = (TAU * 50.0, OMEGA * t);
            let (envelope, slope) = (
                40.0 * (mains * t).sin().abs(),
                40.0 * mains * (mains * t).cos() * (mains * t).sin().signum(),
            );
            let i = envelope * turn.cos();
            let d = slope * turn.cos() - envelope * OMEGA * turn.sin();
            let tone = v * ((OMEGA + TAU * offset_hz) * t + 0.7).cos();
            v_v.push(3.0 * i + 18e-6 * d + tone + noise(0.4));
            i_a.push(i + noise(0.06));
        }
        Segment {
            f_sw_hz: 45e3,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s,
            v_v: v_v.into(),
            i_a: i_a.into(),
        }
    }

    fn reference(segment: &Segment) -> Estimate {
        run(Method::LeastSquares, segment, &IdentifyOptions::default()).expect("a steady load")
    }

    #[test]
    fn a_tone_is_found_where_it_is_and_taken_out_it_costs_nothing() {
        for (offset_hz, v) in [
            (1200.0, 8.0),
            (-2_030.0, 4.0),
            (730.0, 2.0),
            (100.0, 4.0),
            (-300.0, 4.0),
            (79.0, 4.0),
        ] {
            let with = segment(offset_hz, v);
            let tones = find(&with, WhiteNoise::measure(&with)).tones;
            let strongest = tones
                .iter()
                .max_by(|a, b| a.v.norm().total_cmp(&b.v.norm()));
            let found = strongest.expect("a tone");
            assert!((found.offset_hz - offset_hz).abs() < 8.0, "{found:?}");
            assert!((found.v.norm() / v - 1.0).abs() < 0.1, "{found:?}");
            let clean = segment(0.0, 0.0);
            let error = |s: &Segment| {
                let all = comparison::differences(&clean, &reference(s), &reference(&clean));
                all.iter().map(|d| d.mean_pct[0]).fold(0.0, f64::max)
            };
            let (before, after) = (error(&with), error(&remove_tones(&with, &tones)));
            assert!(
                after < 0.25 * before,
                "{offset_hz}: {before} % to {after} %"
            );
        }
    }

    #[test]
    fn there_is_no_tone_where_there_is_none() {
        let clean = segment(0.0, 0.0);
        let found = find(&clean, WhiteNoise::measure(&clean));
        assert_eq!(found.tones, []);
        assert!(found.law_remark(&clean).is_none(), "{:?}", found.fits);
    }
}
