//! Runs the power stage and records it.

use std::collections::BTreeMap;

use ihd_firmware::drive::Bridge;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, FrequencyStep, Segment, TimeBase};

use super::prepared::PreparedLoad;
use super::sampler::Sampler;
use super::sensing::Rate;
use super::settings::{Change, Settings};
use crate::inverter::bridge::HalfBridge;
use crate::inverter::bus::Bus;
use crate::inverter::harmonic_analyser::{HarmonicAnalyser, PeriodSums};
use crate::inverter::{Inverter, InverterError};
use crate::mains::Mains;

/// What came out.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What went in.
    pub settings: Settings,
    /// Sampling instants of the voltage, in seconds after the recording's start.
    pub t_s: Vec<f64>,
    /// Voltage codes.
    pub v_code: Vec<i16>,
    /// Current codes.
    pub i_code: Vec<i16>,
    /// Voltage after the analogue chain without noise, in volt.
    pub v_clean_v: Vec<f64>,
    /// Current likewise, in ampere.
    pub i_clean_a: Vec<f64>,
    /// Truth of every switching period.
    pub truth: Vec<PeriodTruth>,
}

impl Recording {
    /// Volt of one voltage code.
    pub fn volt_per_code(&self) -> f64 {
        let s = &self.settings.sensing;
        s.v_full_scale_v / f64::from(1u32 << (s.bits - 1))
    }

    /// Ampere of one current code.
    pub fn ampere_per_code(&self) -> f64 {
        let s = &self.settings.sensing;
        s.i_full_scale_a / f64::from(1u32 << (s.bits - 1))
    }

    /// The recording as a capture, named `name`.
    pub fn capture(&self, name: &str) -> Capture {
        let settings = &self.settings;
        let scaled = |codes: &[i16], unit: f64| {
            let volt = |c: &i16| (f64::from(*c) * unit) as f32;
            codes.iter().map(volt).collect()
        };
        let time = match settings.sensing.rate {
            Rate::Locked => TimeBase::Stamps(self.t_s.clone()),
            Rate::Hz(rate_hz) => TimeBase::Even {
                t0_s: self.t_s.first().copied().unwrap_or(0.0),
                dt_s: 1.0 / rate_hz,
            },
        };
        Capture {
            name: name.to_owned(),
            time,
            v_v: scaled(&self.v_code, self.volt_per_code()),
            i_a: scaled(&self.i_code, self.ampere_per_code()),
            v_full_scale_v: Some(settings.sensing.v_full_scale_v),
            i_full_scale_a: Some(settings.sensing.i_full_scale_a),
            f_sw: FrequencyStep::of_truth(&self.truth),
            mains_hz: Some(settings.mains_hz),
            zero_crossing_s: Some(-settings.start_s),
            truth: self.truth.clone(),
            metadata: BTreeMap::new(),
        }
    }

    /// The waveforms without noise and quantising as a segment; of a recording with a fixed
    /// sampling rate.
    pub fn clean_segment(&self) -> Segment {
        let t_s = &self.t_s;
        let span_s = t_s.last().copied().unwrap_or(0.0) - t_s.first().copied().unwrap_or(0.0);
        Segment {
            f_sw_hz: self.settings.f_sw_hz,
            mains_hz: self.settings.mains_hz,
            zero_crossing_s: -self.settings.start_s,
            t0_s: t_s.first().copied().unwrap_or(0.0),
            dt_s: span_s / t_s.len().saturating_sub(1).max(1) as f64,
            v_v: self.v_clean_v.clone(),
            i_a: self.i_clean_a.clone(),
        }
    }
}

/// Simulates; `progress` hears the finished share, 0 to 1, once a switching period.
pub fn record(
    settings: &Settings,
    mut progress: impl FnMut(f64),
) -> Result<Recording, InverterError> {
    settings.check()?;
    let mains = Mains::new(settings.mains_hz).with_harmonics(settings.mains_harmonics);
    let mut prepared = PreparedLoad::new(settings.load, &settings.pot, settings.winding_r_ohm)?;
    let steps = settings.steps(settings.f_sw_hz);
    let mut inverter = Inverter::new(
        Bus::new(mains, settings.bus_capacitance_f, settings.start_s)?,
        HalfBridge::new(settings.dead_s, settings.edge_s)?,
        prepared.start(settings.f_sw_hz, steps, None)?,
        settings.f_sw_hz,
        steps,
        settings.start_s,
    );
    let mut analyser = HarmonicAnalyser::new(steps);
    let mut sampler = Sampler::new(&settings.sensing, inverter.instant());
    let mut truth = Vec::new();
    let mut before: Option<PeriodSums> = None;
    let mut bridge = Bridge::Switching;
    let mut events = settings.events.iter().peekable();
    let end_s = settings.start_s + settings.duration_s;
    while inverter.now_s() < end_s {
        let elapsed_s = inverter.now_s() - settings.start_s;
        while let Some(event) = events.next_if(|e| e.t_s <= elapsed_s) {
            match event.change {
                Change::On => bridge = Bridge::Switching,
                Change::Off => bridge = Bridge::Open,
                Change::Frequency(f) => change_frequency(&mut inverter, &prepared, f, settings)?,
                Change::Pot(pot) => {
                    prepared = PreparedLoad::new(settings.load, &pot, settings.winding_r_ohm)?;
                    let f = inverter.f_sw_hz();
                    inverter.load = prepared.start(f, inverter.steps(), Some(&inverter.load))?;
                }
            }
            analyser = HarmonicAnalyser::new(inverter.steps());
            before = None;
        }
        truth.push(record_period(
            &mut inverter,
            bridge,
            &mut analyser,
            &mut before,
            &mut sampler,
            settings.start_s,
        ));
        progress((elapsed_s / settings.duration_s).min(1.0));
    }
    progress(1.0);
    let (mut v_code, mut i_code) = sampler.finish(settings.seed);
    // The last switching period runs over the end; a picosecond absorbs rounding of the times.
    let cut_s = end_s - 1e-12;
    let n = v_code
        .len()
        .min(sampler.t_s.partition_point(|t| *t < cut_s));
    let mut t_s = sampler.t_s;
    t_s.truncate(n);
    v_code.truncate(n);
    i_code.truncate(n);
    t_s.iter_mut().for_each(|t| *t -= settings.start_s);
    sampler.v_v.truncate(n);
    sampler.i_a.truncate(n);
    Ok(Recording {
        settings: settings.clone(),
        t_s,
        v_code,
        i_code,
        v_clean_v: sampler.v_v,
        i_clean_a: sampler.i_a,
        truth,
    })
}

/// One switching period; returns the truth at its start, from it and the period `before`, or that of
/// its middle where there is none to go with it.
fn record_period(
    inverter: &mut Inverter,
    bridge: Bridge,
    analyser: &mut HarmonicAnalyser,
    before: &mut Option<PeriodSums>,
    sampler: &mut Sampler,
    start_s: f64,
) -> PeriodTruth {
    let f_sw_hz = inverter.f_sw_hz();
    let mut last = inverter.instant();
    let from_s = last.t_s - start_s;
    analyser.push(0, last.coil_v, last.i_a);
    for n in 1..=inverter.steps() {
        last = inverter.advance(bridge);
        analyser.push(n, last.coil_v, last.i_a);
        sampler.push(last, f_sw_hz);
    }
    let sums = analyser.sums();
    match before.replace(sums.clone()) {
        Some(before) if before.fits(sums) => before.across(sums, from_s, f_sw_hz),
        _ => analyser.truth(from_s + 0.5 / f_sw_hz, f_sw_hz, last.i_a),
    }
}

/// The field keeps its state across a change of frequency, only its time step moves a little.
fn change_frequency(
    inverter: &mut Inverter,
    prepared: &PreparedLoad,
    f_sw_hz: f64,
    settings: &Settings,
) -> Result<(), InverterError> {
    let steps = settings.steps(f_sw_hz);
    let mut load = inverter.load.clone();
    if !load.set_dt(1.0 / (f_sw_hz * steps as f64))? {
        load = prepared.start(f_sw_hz, steps, Some(&load))?;
    }
    inverter.restart(load, f_sw_hz, steps);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::settings::{Event, LoadKind};
    use super::*;
    use crate::behavioural;
    use crate::behavioural::PotKind;
    use crate::field::gap::GapOperator;
    use crate::field::geometry::Geometry;
    use crate::pot::Pot;

    fn behavioural(duration_s: f64) -> Settings {
        Settings {
            load: LoadKind::Behavioural,
            duration_s,
            ..Settings::default()
        }
    }

    #[test]
    fn truth_of_the_behavioural_load_is_its_law() {
        let r = record(&behavioural(10e-3), |_| ()).unwrap();
        assert_eq!(r.v_code.len(), 500_000);
        let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
        let mut compared = 0;
        for t in r.truth.iter().filter(|t| t.i_a > 2.0) {
            // The law sees the envelope of the past period: half a period late.
            let (r_ohm, l_h) = law.r_l(t.i_a);
            assert!((t.r_ohm[0] / r_ohm - 1.0).abs() < 0.02, "{t:?} {r_ohm}");
            assert!((t.l_h[0] / l_h - 1.0).abs() < 0.02, "{t:?} {l_h}");
            compared += 1;
        }
        assert!(compared > 350);
    }

    #[test]
    fn the_same_seed_gives_the_same_record_and_another_does_not() {
        let mut s = behavioural(1e-3);
        s.sensing.snr_db = Some(30.0);
        let a = record(&s, |_| ()).unwrap();
        assert_eq!(a, record(&s, |_| ()).unwrap());
        s.seed = 2;
        assert_ne!(a.v_code, record(&s, |_| ()).unwrap().v_code);
    }

    #[test]
    fn events_change_frequency_pot_and_bridge() {
        let mut s = behavioural(10e-3);
        s.events = vec![
            Event {
                t_s: 3e-3,
                change: Change::Frequency(60e3),
            },
            Event {
                t_s: 5e-3,
                change: Change::Pot(Pot::NONE),
            },
            Event {
                t_s: 7e-3,
                change: Change::Off,
            },
        ];
        let r = record(&s, |_| ()).unwrap();
        let at = |t_s: f64| r.truth.iter().find(|t| t.t_s > t_s).unwrap();
        assert_eq!(at(2e-3).f_sw_hz, 45e3);
        assert_eq!(at(4e-3).f_sw_hz, 60e3);
        assert!(
            (at(6e-3).l_h[0] / 70e-6 - 1.0).abs() < 0.02,
            "{:?}",
            at(6e-3)
        );
        assert!(at(9e-3).i_a < 0.2 * at(6.9e-3).i_a);
    }

    #[test]
    fn taking_the_pot_off_the_field_model_leaves_the_bare_coil() {
        let mut s = Settings {
            duration_s: 4e-3,
            ..Settings::default()
        };
        s.events = vec![
            Event {
                t_s: 2e-3,
                change: Change::Frequency(50e3),
            },
            Event {
                t_s: 3e-3,
                change: Change::Pot(Pot::NONE),
            },
        ];
        let r = record(&s, |_| ()).unwrap();
        let before = r.truth.iter().rfind(|t| t.t_s < 2.9e-3).unwrap();
        let after = r.truth.last().unwrap();
        let bare = GapOperator::bare_coil_h(&Geometry::paper(), 1.0).unwrap();
        assert!(before.l_h[0] < 30e-6, "{before:?}");
        assert!((after.l_h[0] / bare - 1.0).abs() < 0.01, "{after:?} {bare}");
        assert!(after.r_ohm[0].abs() < 0.2);
        // No step of the current at the exchange.
        let jump = r
            .i_clean_a
            .windows(2)
            .map(|w| (w[1] - w[0]).abs())
            .fold(0.0, f64::max);
        assert!(jump < 2.0, "{jump}");
    }

    #[test]
    fn dead_time_is_invisible_to_lagging_current() {
        let a = record(&behavioural(3e-3), |_| ()).unwrap();
        let b = record(
            &Settings {
                dead_s: 1e-6,
                ..behavioural(3e-3)
            },
            |_| (),
        )
        .unwrap();
        let (x, y) = (a.truth.last().unwrap(), b.truth.last().unwrap());
        assert!((x.i_a / y.i_a - 1.0).abs() < 0.01, "{x:?} {y:?}");
    }

    #[test]
    fn a_bus_capacitor_keeps_current_flowing_at_the_zero_crossing() {
        let with = |bus_capacitance_f| {
            let s = Settings {
                bus_capacitance_f,
                f_sw_hz: 70e3,
                ..behavioural(10.5e-3)
            };
            let r = record(&s, |_| ()).unwrap();
            r.truth.iter().rfind(|t| t.t_s < 10e-3).unwrap().i_a
        };
        let (without, small, large) = (with(0.0), with(5e-6), with(50e-6));
        assert!(
            without < 0.2 && small > without && large > 3.0,
            "{without} {small} {large}"
        );
    }

    #[test]
    fn a_distorted_mains_has_a_flatter_crest() {
        let at_crest = |mains_harmonics| {
            let s = Settings {
                mains_harmonics,
                ..behavioural(5.2e-3)
            };
            let r = record(&s, |_| ()).unwrap();
            r.truth.iter().rfind(|t| t.t_s < 5e-3).unwrap().i_a
        };
        // 5 % of third harmonic take 5 % off the crest; the load is nonlinear, so about that.
        let ratio = at_crest([0.05, 0.0, 0.0]) / at_crest([0.0; 3]);
        assert!((0.90..0.98).contains(&ratio), "{ratio}");
    }
}
