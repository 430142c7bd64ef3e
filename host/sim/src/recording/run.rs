//! Simulation of the power stage with a recording.

use std::collections::BTreeMap;

use ihd_firmware::drive::bridge::Bridge;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, FrequencyStep, Segment, TimeBase};

use super::prepared::PreparedLoad;
use super::sampler::{Sampler, convert};
use super::sensing::Rate;
use super::settings::{CaptureSpec, RecordingChange};
use crate::inverter::bridge::SwitchedHalfBridge;
use crate::inverter::bus::Bus;
use crate::inverter::harmonic_analyser::{HarmonicAnalyser, PeriodSums};
use crate::inverter::{InducedTone, Inverter, InverterError};
use crate::mains::SimulatedMains;

/// Result of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedRecording {
    /// Specification.
    pub settings: CaptureSpec,
    /// Sampling instants of the voltage, in seconds after the recording's start.
    pub t_s: Vec<f64>,
    /// Voltage codes.
    pub v_code: Vec<i16>,
    /// Current codes.
    pub i_code: Vec<i16>,
    /// Voltage after the analogue chain without noise, in volt.
    pub v_clean_v: Vec<f64>,
    /// Current after the analogue chain without noise, in ampere.
    pub i_clean_a: Vec<f64>,
    /// Truth of every switching period.
    pub truth: Vec<PeriodTruth>,
}

impl SimulatedRecording {
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

    /// Returns the same waveforms and truth with another seed's noise and spikes.
    pub fn with_seed(&self, seed: u64) -> Self {
        let sensing = &self.settings.sensing;
        let (v_code, i_code) = convert(sensing, &self.t_s, &self.v_clean_v, &self.i_clean_a, seed);
        Self {
            settings: CaptureSpec {
                seed,
                ..self.settings.clone()
            },
            v_code,
            i_code,
            ..self.clone()
        }
    }

    /// Converts the recording to a capture named `name`.
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
            // A moving carrier has no steps.
            f_sw: match settings.sweep {
                Some(_) => Vec::new(),
                None => FrequencyStep::of_truth(&self.truth),
            },
            mains_hz: Some(settings.mains_hz),
            zero_crossing_s: Some(-settings.start_s),
            truth: self.truth.clone(),
            metadata: BTreeMap::new(),
        }
    }

    /// Waveforms without noise and quantising as a segment; for a recording with a fixed sampling rate.
    pub fn clean_segment(&self) -> Segment {
        let t_s = &self.t_s;
        let span_s = t_s.last().copied().unwrap_or(0.0) - t_s.first().copied().unwrap_or(0.0);
        Segment {
            f_sw_hz: self.settings.f_sw_hz,
            mains_hz: self.settings.mains_hz,
            zero_crossing_s: -self.settings.start_s,
            t0_s: t_s.first().copied().unwrap_or(0.0),
            dt_s: span_s / t_s.len().saturating_sub(1).max(1) as f64,
            v_v: self.v_clean_v.clone().into(),
            i_a: self.i_clean_a.clone().into(),
        }
    }
}

/// Simulates; `progress` is called with the share done, 0 to 1, once a switching period.
pub fn record(
    settings: &CaptureSpec,
    mut progress: impl FnMut(f64),
) -> Result<SimulatedRecording, InverterError> {
    settings.check()?;
    let mut prepared = PreparedLoad::new(settings.load, &settings.pot, settings.winding_r_ohm)?;
    let mut inverter = power_stage(settings, &prepared)?;
    let mut periods = Periods::new(inverter.steps());
    let mut sampler = Sampler::new(&settings.sensing, inverter.instant());
    let mut truth = Vec::new();
    let mut bridge = Bridge::Switching;
    let mut set_hz = settings.f_sw_hz;
    let mut events = settings.events.iter().peekable();
    let end_s = settings.start_s + settings.duration_s;
    while inverter.now_s() < end_s {
        let elapsed_s = inverter.now_s() - settings.start_s;
        while let Some(event) = events.next_if(|e| e.t_s <= elapsed_s) {
            match event.change {
                RecordingChange::On => bridge = Bridge::Switching,
                RecordingChange::Off => bridge = Bridge::Open,
                RecordingChange::Frequency(f) => {
                    set_hz = f;
                    change_frequency(&mut inverter, &prepared, f, settings)?;
                }
                RecordingChange::Pot(pot) => {
                    prepared = PreparedLoad::new(settings.load, &pot, settings.winding_r_ohm)?;
                    let f = inverter.f_sw_hz();
                    inverter.load = prepared.start(f, inverter.steps(), Some(&inverter.load))?;
                }
                RecordingChange::Load { r_factor, l_factor } => {
                    inverter.load.scale(r_factor, l_factor)
                }
            }
            periods = Periods::new(inverter.steps());
        }
        if settings.sweep.is_some() {
            sweep_to(
                &mut inverter,
                &prepared,
                settings.swept_hz(set_hz, elapsed_s),
            )?;
        }
        truth.push(periods.record(&mut inverter, bridge, &mut sampler, settings.start_s));
        progress((elapsed_s / settings.duration_s).min(1.0));
    }
    progress(1.0);
    // The last switching period runs over the end; a picosecond absorbs rounding of the times.
    sampler.cut(end_s - 1e-12);
    let (v_code, i_code) = sampler.finish(settings.seed);
    let mut t_s = sampler.t_s;
    t_s.iter_mut().for_each(|t| *t -= settings.start_s);
    Ok(SimulatedRecording {
        settings: settings.clone(),
        t_s,
        v_code,
        i_code,
        v_clean_v: sampler.v_v,
        i_clean_a: sampler.i_a,
        truth,
    })
}

/// Creates the power stage at rest, with the load `prepared`.
fn power_stage(settings: &CaptureSpec, prepared: &PreparedLoad) -> Result<Inverter, InverterError> {
    let mains = SimulatedMains::new(settings.mains_hz).with_harmonics(settings.mains_harmonics);
    let steps = settings.steps(settings.f_sw_hz);
    let mut inverter = Inverter::new(
        Bus::new(mains, settings.supply(), settings.start_s)?,
        SwitchedHalfBridge::new(settings.dead_s, settings.edge_s)?.with_duty(settings.duty)?,
        prepared.start(settings.f_sw_hz, steps, None)?,
        settings.f_sw_hz,
        steps,
        settings.start_s,
    );
    inverter.bridge_r_ohm = settings.bridge_r_ohm;
    inverter.induced = settings.neighbour.map(|n| InducedTone {
        f_hz: settings.f_sw_hz + n.offset_hz,
        v: n.v,
    });
    Ok(inverter)
}

/// Computes the truth from the waveform, period by period.
struct Periods {
    analyser: HarmonicAnalyser,
    /// Sums and frequency in hertz of the period before; `None` if the next does not continue it.
    before: Option<(PeriodSums, f64)>,
}

impl Periods {
    fn new(steps: usize) -> Self {
        Self {
            analyser: HarmonicAnalyser::new(steps),
            before: None,
        }
    }

    /// Simulates one switching period; returns the truth at its start, from it and the period before, or that of its middle if
    /// there is none before. The voltage induced by a neighbour is no part of the load.
    fn record(
        &mut self,
        inverter: &mut Inverter,
        bridge: Bridge,
        sampler: &mut Sampler,
        start_s: f64,
    ) -> PeriodTruth {
        let f_sw_hz = inverter.f_sw_hz();
        let mut last = inverter.instant();
        let (from_s, from_a) = (last.t_s - start_s, last.i_a);
        self.analyser
            .push(0, last.coil_v - last.induced_v, last.i_a);
        for n in 1..=inverter.steps() {
            last = inverter.advance(bridge);
            self.analyser
                .push(n, last.coil_v - last.induced_v, last.i_a);
            sampler.push(last, f_sw_hz);
        }
        let sums = self.analyser.sums();
        match self.before.replace((sums.clone(), f_sw_hz)) {
            Some((before, before_hz)) if before.fits(sums) && before_hz == f_sw_hz => {
                before.across(sums, from_s, f_sw_hz)
            }
            Some((before, before_hz)) if before.fits(sums) => {
                before.across_change(sums, from_s, [before_hz, f_sw_hz], from_a)
            }
            _ => (self.analyser).truth(from_s + 0.5 / f_sw_hz, f_sw_hz, last.i_a),
        }
    }
}

/// Changes the period's length, with as many steps; everything else continues.
fn sweep_to(
    inverter: &mut Inverter,
    prepared: &PreparedLoad,
    f_sw_hz: f64,
) -> Result<(), InverterError> {
    let steps = inverter.steps();
    let mut load = inverter.load.clone();
    match prepared.law(f_sw_hz) {
        Some(law) => load.set_law(law),
        None => {
            load.set_dt(1.0 / (f_sw_hz * steps as f64))?;
        }
    }
    inverter.restart(load, f_sw_hz, steps);
    Ok(())
}

/// Changes the frequency. The field keeps its state; its time step moves a little.
fn change_frequency(
    inverter: &mut Inverter,
    prepared: &PreparedLoad,
    f_sw_hz: f64,
    settings: &CaptureSpec,
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
    use super::super::settings::{CarrierSweep, LoadKind, Neighbour, RecordingEvent};
    use super::*;
    use crate::behavioural;
    use crate::behavioural::PotKind;
    use crate::pot::SimulatedPot;
    use ihd_field::model::FieldSettings;
    use ihd_field::{FieldModel, harmonic};

    fn behavioural(duration_s: f64) -> CaptureSpec {
        CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s,
            ..CaptureSpec::default()
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
            RecordingEvent {
                t_s: 3e-3,
                change: RecordingChange::Frequency(60e3),
            },
            RecordingEvent {
                t_s: 5e-3,
                change: RecordingChange::Pot(SimulatedPot::NONE),
            },
            RecordingEvent {
                t_s: 7e-3,
                change: RecordingChange::Off,
            },
        ];
        let r = record(&s, |_| ()).unwrap();
        let at = |t_s: f64| r.truth.iter().find(|t| t.t_s > t_s).unwrap();
        assert_eq!(at(2e-3).f_sw_hz, 45e3);
        assert_eq!(at(4e-3).f_sw_hz, 60e3);
        assert!(
            (at(6e-3).l_h[0] / 50.5e-6 - 1.0).abs() < 0.02,
            "{:?}",
            at(6e-3)
        );
        assert!(at(9e-3).i_a < 0.2 * at(6.9e-3).i_a);
    }

    #[test]
    fn taking_the_pot_off_the_field_model_leaves_the_bare_coil() {
        let mut s = CaptureSpec {
            duration_s: 4e-3,
            ..CaptureSpec::default()
        };
        s.events = vec![
            RecordingEvent {
                t_s: 2e-3,
                change: RecordingChange::Frequency(50e3),
            },
            RecordingEvent {
                t_s: 3e-3,
                change: RecordingChange::Pot(SimulatedPot::NONE),
            },
        ];
        let r = record(&s, |_| ()).unwrap();
        let before = r.truth.iter().rfind(|t| t.t_s < 2.9e-3).unwrap();
        let after = r.truth.last().unwrap();
        let bare = FieldModel::bare_coil(&FieldSettings::paper()).unwrap();
        let bare = harmonic::impedance(&bare, 50e3, 1.0).unwrap().l_h;
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
            &CaptureSpec {
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
            let s = CaptureSpec {
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

    /// Every period has its own frequency, and the law's R and L there.
    #[test]
    fn a_swept_carrier_has_its_frequency_and_load_in_every_period() {
        let s = CaptureSpec {
            sweep: Some(CarrierSweep {
                deviation_hz: 3e3,
                rate_hz: 500.0,
            }),
            ..behavioural(10e-3)
        };
        let r = record(&s, |_| ()).unwrap();
        let mut from_s = 0.0;
        for t in r.truth.windows(2) {
            // Truth stands at the boundary between two periods, with the mean of both frequencies.
            assert!((t[1].f_sw_hz - s.swept_hz(45e3, t[1].t_s)).abs() < 300.0);
            assert!(t[1].t_s > from_s);
            from_s = t[1].t_s;
            if t[1].i_a > 5.0 {
                let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, t[1].f_sw_hz);
                let (r_ohm, l_h) = law.r_l(t[1].i_a);
                assert!((t[1].r_ohm[0] / r_ohm - 1.0).abs() < 0.02, "{t:?} {r_ohm}");
                assert!((t[1].l_h[0] / l_h - 1.0).abs() < 0.01, "{t:?} {l_h}");
            }
        }
        let reached =
            |f: fn(f64, f64) -> f64, from| r.truth.iter().map(|t| t.f_sw_hz).fold(from, f);
        assert!((reached(f64::max, 0.0) - 48e3).abs() < 50.0);
        assert!((reached(f64::min, 1e6) - 42e3).abs() < 50.0);
        // The sweep's mean is the carrier's: so many periods fit.
        assert!(r.truth.len().abs_diff(450) <= 1, "{}", r.truth.len());
        assert!(r.capture("swept").f_sw.is_empty());
    }

    /// Between edges the node stands at the bus less r·i: the plateau v + ∫i/C shows r, R and L do not.
    #[test]
    fn the_bridges_resistance_is_no_part_of_the_coil() {
        let with = |bridge_r_ohm| {
            let s = CaptureSpec {
                bridge_r_ohm,
                start_s: 3e-3,
                ..behavioural(4e-3)
            };
            record(&s, |_| ()).unwrap()
        };
        let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
        let r_ohm = 0.2;
        let bridged = with(r_ohm);
        for t in bridged.truth.iter().skip(20) {
            assert!((t.r_ohm[0] / law.r_l(t.i_a).0 - 1.0).abs() < 0.01, "{t:?}");
        }
        // The lower switch's plateau: from 0.6 to 0.9 of every period the node is at −r i.
        let (mut charge_c, mut cross, mut square) = (0.0, 0.0, 0.0);
        let dt_s = 20e-9;
        for k in 1..bridged.t_s.len() {
            charge_c += 0.5 * (bridged.i_clean_a[k] + bridged.i_clean_a[k - 1]) * dt_s;
            if (0.6..0.9).contains(&(bridged.t_s[k] * 45e3).fract()) {
                let node_v = bridged.v_clean_v[k] + charge_c / 1080e-9;
                cross += node_v * bridged.i_clean_a[k];
                square += bridged.i_clean_a[k].powi(2);
            }
        }
        assert!(
            (-cross / square / r_ohm - 1.0).abs() < 0.02,
            "{}",
            -cross / square
        );
    }

    /// The part of the coil's voltage that R and L leave is the neighbour's tone, in amplitude and frequency.
    #[test]
    fn a_neighbour_is_what_r_and_l_leave_unexplained() {
        let s = CaptureSpec {
            load: LoadKind::Behavioural,
            pot: SimulatedPot::NONE,
            start_s: 2e-3,
            duration_s: 5e-3,
            neighbour: Some(Neighbour {
                offset_hz: 1.2e3,
                v: 8.0,
            }),
            ..CaptureSpec::default()
        };
        let r = record(&s, |_| ()).unwrap();
        let law = behavioural::BehaviouralLoad::new(PotKind::None, 45e3);
        let (r_ohm, l_h) = law.r_l(1.0);
        let truth = &r.truth[100];
        assert!((truth.r_ohm[0] / r_ohm - 1.0).abs() < 1e-2, "{truth:?}");
        assert!((truth.l_h[0] / l_h - 1.0).abs() < 1e-3, "{truth:?}");
        let dt_s = 20e-9;
        let (mut re, mut im, mut n) = (0.0, 0.0, 0.0);
        for k in 1..r.t_s.len() - 1 {
            let slope = (r.i_clean_a[k + 1] - r.i_clean_a[k - 1]) / (2.0 * dt_s);
            let left_v = r.v_clean_v[k] - r_ohm * r.i_clean_a[k] - l_h * slope;
            let angle = std::f64::consts::TAU * 46.2e3 * (r.t_s[k] + s.start_s);
            (re, im, n) = (
                re + left_v * angle.sin(),
                im + left_v * angle.cos(),
                n + 1.0,
            );
        }
        let (re, im) = (2.0 * re / n, 2.0 * im / n);
        assert!((re / 8.0 - 1.0).abs() < 0.02 && im.abs() < 0.2, "{re} {im}");
    }

    #[test]
    fn a_load_step_scales_the_law_until_the_next() {
        let step = |t_s, r_factor, l_factor| RecordingEvent {
            t_s,
            change: RecordingChange::Load { r_factor, l_factor },
        };
        let s = CaptureSpec {
            events: vec![step(4e-3, 0.6, 1.35), step(6e-3, 1.0, 1.0)],
            ..behavioural(8e-3)
        };
        let r = record(&s, |_| ()).unwrap();
        let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
        for (from_s, to_s, r_factor, l_factor) in [
            (3e-3, 3.9e-3, 1.0, 1.0),
            (4.3e-3, 5.9e-3, 0.6, 1.35),
            (6.3e-3, 7.9e-3, 1.0, 1.0),
        ] {
            for t in r.truth.iter().filter(|t| (from_s..to_s).contains(&t.t_s)) {
                let (r_ohm, l_h) = law.r_l(t.i_a);
                assert!(
                    (t.r_ohm[0] / (r_factor * r_ohm) - 1.0).abs() < 0.01,
                    "{t:?}"
                );
                assert!((t.l_h[0] / (l_factor * l_h) - 1.0).abs() < 0.01, "{t:?}");
            }
        }
    }

    #[test]
    fn another_seed_is_another_noise_on_the_same_waveform() {
        let mut s = behavioural(1e-3);
        s.sensing.snr_db = Some(30.0);
        let first = record(&s, |_| ()).unwrap();
        let again = first.with_seed(2);
        assert!(again.v_clean_v == first.v_clean_v && again.truth == first.truth);
        let noise_a = |r: &SimulatedRecording| -> Vec<f64> {
            let seen = r.i_code.iter().map(|c| f64::from(*c) * r.ampere_per_code());
            seen.zip(&r.i_clean_a).map(|(y, x)| y - x).collect()
        };
        let (a, b) = (noise_a(&first), noise_a(&again));
        let power = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        assert!((power(&a, &b) / power(&a, &a)).abs() < 0.03, "uncorrelated");
        s.seed = 2;
        assert!(again == record(&s, |_| ()).unwrap());
    }

    #[test]
    fn a_mains_of_47_hertz_has_its_zero_crossings_there() {
        let s = CaptureSpec {
            mains_hz: 47.0,
            ..behavioural(22e-3)
        };
        let r = record(&s, |_| ()).unwrap();
        for crossing_s in [0.5 / 47.0, 1.0 / 47.0] {
            let least = (r.truth.iter().filter(|t| (t.t_s - crossing_s).abs() < 1e-3))
                .min_by(|a, b| a.i_a.total_cmp(&b.i_a))
                .unwrap();
            assert!((least.t_s - crossing_s).abs() < 0.1e-3, "{least:?}");
        }
    }

    #[test]
    fn a_distorted_mains_has_a_flatter_crest() {
        let at_crest = |mains_harmonics| {
            let s = CaptureSpec {
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
