//! Values over a preset: keys of `--set`.

use clap::Args;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{
    CaptureSpec, CarrierSweep, LoadKind, Neighbour, RecordingEvent,
};

use super::LoadWord;
use super::event::event;
use super::quantity::{self, list, quantity};

/// Values over a preset: keys of `--set`.
#[derive(Debug, Args)]
pub(super) struct SpecOptions {
    /// Switching frequency in Hz
    #[arg(long, value_parser = quantity)]
    fsw: Option<f64>,
    /// Sweep the switching frequency by so many Hz up and down, so many times a second: 5k,100
    #[arg(long, value_parser = list::<2>, value_name = "HZ,HZ")]
    sweep: Option<[f64; 2]>,
    /// Share of the period in which the upper switch is on, 0.2 to 0.8
    #[arg(long, value_parser = quantity)]
    duty: Option<f64>,
    /// Resistance of the bridge's switches in ohm, outside the coil
    #[arg(long, value_parser = quantity, value_name = "OHM")]
    bridge_resistance: Option<f64>,
    /// Another zone's field induces a sine in the coil: so many Hz above the switching frequency, so many V: 1.2k,8
    #[arg(long, value_parser = list::<2>, value_name = "HZ,V")]
    neighbour: Option<[f64; 2]>,
    /// Mains frequency in Hz
    #[arg(long, value_parser = quantity)]
    mains: Option<f64>,
    /// Mains distortion: third, fifth and seventh harmonic in percent, as in 4,-2,1
    #[arg(long, value_parser = list::<3>, value_name = "PCT,PCT,PCT")]
    distortion: Option<[f64; 3]>,
    /// Bus capacitance in F; 0: the bus is the rectified mains
    #[arg(long, value_parser = quantity)]
    bus_capacitance: Option<f64>,
    /// Inductance of the house's line in H, before a bus capacitance; 0: none
    #[arg(long, value_parser = quantity)]
    line_inductance: Option<f64>,
    /// Dead time of the half-bridge in s
    #[arg(long, value_parser = quantity)]
    dead_time: Option<f64>,
    /// METAL-D: ferritic, cast-iron, stainless, aluminium, clad (aluminium on a ferritic foil), foil, lid, spoon or ring, with D = 4 to 28 (cm); or none
    #[arg(long)]
    pot: Option<SimulatedPot>,
    /// Lift the pot, in m (5mm)
    #[arg(long, value_parser = quantity, default_value = "0")]
    lift: f64,
    /// Move the pot off centre, in m (20mm)
    #[arg(long, value_parser = quantity, default_value = "0")]
    offset: f64,
    /// Temperature of the pot in °C
    #[arg(long, default_value = "20")]
    temperature: f64,
    /// Load model
    #[arg(long)]
    load: Option<LoadWord>,
    /// Winding resistance in ohm
    #[arg(long, value_parser = quantity)]
    winding: Option<f64>,
    /// Start this long after a mains zero crossing, from rest, in s
    #[arg(long, value_parser = quantity)]
    start: Option<f64>,
    /// Length in s
    #[arg(long, value_parser = quantity)]
    duration: Option<f64>,
    /// Integration step in s
    #[arg(long, value_parser = quantity)]
    step: Option<f64>,
    /// Change something meanwhile: TIME:fsw=60k, TIME:pot=none, TIME:load=0.6,1.35 (R and L of a law times
    /// these), TIME:off or TIME:on; repeatable
    #[arg(long, value_parser = event, value_name = "EVENT")]
    at: Vec<RecordingEvent>,
    #[command(flatten)]
    sensing: SensingOptions,
}

/// Sensing chain.
#[derive(Debug, Args)]
struct SensingOptions {
    /// Sampling rate in S/s, or `locked` for f_sw · 61/3
    #[arg(long, value_parser = rate)]
    rate: Option<Rate>,
    /// Accept a rate that cannot show the voltage's edges
    #[arg(long)]
    allow_aliasing: bool,
    /// Resolution of the converters, 8 to 16
    #[arg(long)]
    bits: Option<u32>,
    /// Signal-to-noise ratio of white noise in dB (paper, section V)
    #[arg(long)]
    snr: Option<f64>,
    /// Gains of the voltage and current channel, as in 1.01,0.99
    #[arg(long, value_parser = list::<2>, value_name = "V,I")]
    gain: Option<[f64; 2]>,
    /// Offsets of the channels in V and A
    #[arg(long, value_parser = list::<2>, value_name = "V,I")]
    offsets: Option<[f64; 2]>,
    /// Corner of the anti-alias filter in Hz; 0: none
    #[arg(long, value_parser = quantity)]
    pole: Option<f64>,
    /// Corners of a low pass that each channel has of its own in Hz, V,I; 0: none
    #[arg(long, value_parser = list::<2>, value_name = "V,I")]
    poles: Option<[f64; 2]>,
    /// Corner of the current probe's droop (high pass) in Hz; 0: none
    #[arg(long, value_parser = quantity, value_name = "HZ")]
    droop: Option<f64>,
    /// Soft saturation of the current probe in A, s·tanh(i/s); 0: none
    #[arg(long, value_parser = quantity, value_name = "A")]
    saturation: Option<f64>,
    /// Half the ranges of the channels in V and A
    #[arg(long, value_parser = list::<2>, value_name = "V,I")]
    full_scale: Option<[f64; 2]>,
    /// Delay of the current's samples after the voltage's, in s
    #[arg(long, value_parser = quantity)]
    skew: Option<f64>,
    /// Ringing on the voltage after each edge, as a share of the edge
    #[arg(long)]
    ringing: Option<f64>,
    /// Spikes per second
    #[arg(long, value_parser = quantity)]
    spikes: Option<f64>,
}

fn rate(text: &str) -> Result<Rate, quantity::NotANumber> {
    if text == "locked" {
        Ok(Rate::Locked)
    } else {
        quantity(text).map(Rate::Hz)
    }
}

/// Replaces the value if one was given.
fn set<T>(slot: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *slot = value;
    }
}

impl SpecOptions {
    /// Sets what is given.
    pub(super) fn apply(&self, s: &mut CaptureSpec) {
        set(&mut s.f_sw_hz, self.fsw);
        s.sweep = self.sweep.map(|[deviation_hz, rate_hz]| CarrierSweep {
            deviation_hz,
            rate_hz,
        });
        set(&mut s.duty, self.duty);
        set(&mut s.bridge_r_ohm, self.bridge_resistance);
        s.neighbour = (self.neighbour).map(|[offset_hz, v]| Neighbour { offset_hz, v });
        set(&mut s.mains_hz, self.mains);
        set(
            &mut s.mains_harmonics,
            self.distortion.map(|d| d.map(|pct| pct / 100.0)),
        );
        set(&mut s.bus_capacitance_f, self.bus_capacitance);
        set(&mut s.line_l_h, self.line_inductance);
        set(&mut s.dead_s, self.dead_time);
        set(&mut s.pot, self.pot);
        s.pot.lift_m = self.lift;
        s.pot.offset_m = self.offset;
        s.pot.temperature_c = self.temperature;
        set(&mut s.load, self.load.map(LoadKind::from));
        set(&mut s.winding_r_ohm, self.winding);
        set(&mut s.start_s, self.start);
        set(&mut s.duration_s, self.duration);
        set(&mut s.dt_s, self.step);
        s.events.clone_from(&self.at);
        self.sensing.apply(s);
    }
}

impl SensingOptions {
    fn apply(&self, s: &mut CaptureSpec) {
        let sensing = &mut s.sensing;
        set(&mut sensing.rate, self.rate);
        sensing.allow_aliasing = self.allow_aliasing;
        set(&mut sensing.bits, self.bits);
        sensing.snr_db = self.snr;
        if let Some([v, i]) = self.gain {
            (sensing.v_gain, sensing.i_gain) = (v, i);
        }
        if let Some([v, i]) = self.offsets {
            (sensing.v_offset_v, sensing.i_offset_a) = (v, i);
        }
        set(&mut sensing.pole_hz, self.pole);
        if let Some([v, i]) = self.poles {
            (sensing.v_pole_hz, sensing.i_pole_hz) = (v, i);
        }
        set(&mut sensing.i_droop_hz, self.droop);
        set(&mut sensing.i_saturation_a, self.saturation);
        if let Some([v, i]) = self.full_scale {
            (sensing.v_full_scale_v, sensing.i_full_scale_a) = (v, i);
        }
        set(&mut sensing.skew_s, self.skew);
        set(&mut sensing.ringing, self.ringing);
        set(&mut sensing.spikes_per_s, self.spikes);
    }
}
