//! The power stage with its load, one ADC block at a time.

use std::f64::consts::TAU;

use ihd_firmware::realtime::Drive;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};

use super::adc::Adc;
use super::behavioural::{Load, PotKind};
use super::circuit::{BridgeShape, Circuit, STEPS_PER_PERIOD, STEPS_PER_SAMPLE};
use super::mains::Mains;

/// Amplitude of the current's fundamental over the last switching period: a sliding Fourier sum,
/// so that it is continuous in time and the load follows the envelope, not the carrier.
#[derive(Clone, Debug)]
struct Envelope {
    cos_sin: Vec<(f64, f64)>,
    ring: Vec<(f64, f64)>,
    sum: (f64, f64),
}

impl Envelope {
    fn new() -> Self {
        let step = TAU / STEPS_PER_PERIOD as f64;
        Self {
            cos_sin: (0..STEPS_PER_PERIOD)
                .map(|n| (libm::cos(step * n as f64), libm::sin(step * n as f64)))
                .collect(),
            ring: vec![(0.0, 0.0); STEPS_PER_PERIOD],
            sum: (0.0, 0.0),
        }
    }

    fn push(&mut self, n: usize, i_a: f64) {
        let (c, s) = self.cos_sin[n];
        let new = (i_a * c, i_a * s);
        let old = std::mem::replace(&mut self.ring[n], new);
        self.sum.0 += new.0 - old.0;
        self.sum.1 += new.1 - old.1;
    }

    fn amplitude_a(&self) -> f64 {
        let (c, s) = self.sum;
        libm::sqrt(c * c + s * s) * 2.0 / STEPS_PER_PERIOD as f64
    }
}

/// Load and envelope at one ADC sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadPoint {
    /// Time of the sample since the simulation's start, in seconds.
    pub t_s: f64,
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
}

/// Mains, half-bridge, capacitor, load and ADC.
#[derive(Clone, Debug)]
pub struct Plant {
    mains: Mains,
    adc: Adc,
    pot: PotKind,
    load: Load,
    drive: Drive,
    shape: BridgeShape,
    circuit: Circuit,
    envelope: Envelope,
    t_s: f64,
}

impl Plant {
    /// A plant at rest, at a mains zero crossing.
    pub fn new(mains: Mains, pot: PotKind, adc: Adc) -> Self {
        let drive = Drive::OFF;
        let f = f64::from(drive.f_sw_hz);
        Self {
            mains,
            adc,
            pot,
            load: Load::new(pot, f),
            drive,
            shape: BridgeShape::new(f),
            circuit: Circuit::default(),
            envelope: Envelope::new(),
            t_s: 0.0,
        }
    }

    /// Time since the start, in seconds.
    pub fn t_s(&self) -> f64 {
        self.t_s
    }

    /// The mains.
    pub fn mains(&self) -> Mains {
        self.mains
    }

    /// What stands on the coil.
    pub fn pot(&self) -> PotKind {
        self.pot
    }

    /// Puts another pot on the coil, or takes it away.
    pub fn set_pot(&mut self, pot: PotKind) {
        self.pot = pot;
        self.load = Load::new(pot, f64::from(self.drive.f_sw_hz));
    }

    /// Takes effect with the next block; with another frequency the carrier starts anew.
    pub fn set_drive(&mut self, drive: Drive) {
        if drive.f_sw_hz != self.drive.f_sw_hz {
            let f = f64::from(drive.f_sw_hz);
            self.load = Load::new(self.pot, f);
            self.shape = BridgeShape::new(f);
            self.envelope = Envelope::new();
        }
        self.drive = drive;
    }

    /// Simulates one block; `seen` gets the load at every ADC sample. With the bridge off the tank
    /// is shorted by the low-side switch and rings out.
    pub fn block(&mut self, mut seen: impl FnMut(&LoadPoint)) -> [Pair; ADC_LOCK_P] {
        let mut pairs = [Pair::default(); ADC_LOCK_P];
        let dt_s = self.shape.dt_s;
        let on = if self.drive.on { 1.0 } else { 0.0 };
        for (k, pair) in pairs.iter_mut().enumerate() {
            let t_s = self.t_s + (k * STEPS_PER_SAMPLE) as f64 * dt_s;
            let i_a = self.envelope.amplitude_a();
            let (r_ohm, l_h) = self.load.r_l(i_a);
            seen(&LoadPoint {
                t_s,
                r_ohm,
                l_h,
                i_a,
            });
            // The bus moves by 0.03 % within a sample: taken at both ends and in between, linear.
            let bus = [0, STEPS_PER_SAMPLE].map(|n| self.mains.bus_v(t_s + n as f64 * dt_s) * on);
            let first = k * STEPS_PER_SAMPLE % STEPS_PER_PERIOD;
            let bridge_v = |n: usize| {
                let w = n as f64 / STEPS_PER_SAMPLE as f64;
                (bus[0] + w * (bus[1] - bus[0])) * self.shape.level(first + n)
            };
            *pair = self
                .adc
                .convert(bridge_v(0) - self.circuit.v_c_v, self.circuit.i_a);
            for n in 0..STEPS_PER_SAMPLE {
                self.envelope
                    .push((first + n) % STEPS_PER_PERIOD, self.circuit.i_a);
                let mean = 0.5 * (bridge_v(n) + bridge_v(n + 1));
                self.circuit.step(mean, r_ohm, l_h, dt_s);
            }
        }
        self.t_s += (ADC_LOCK_P * STEPS_PER_SAMPLE) as f64 * dt_s;
        pairs
    }
}
