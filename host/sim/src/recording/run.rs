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
mod tests;
