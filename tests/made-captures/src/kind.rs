//! Kinds of captures, and what is drawn for each by seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::circuit::{Bridge, Circuit, LoadLaw, Neighbour};
use crate::sensors::{Recorded, Sensors};

macro_rules! kinds {
    ($($(#[doc = $doc:literal])* $name:ident $text:literal,)*) => {
        /// Kind of capture: the sound ones first, then one disturbance each.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Kind { $($(#[doc = $doc])* $name,)* }

        impl Kind {
            /// All kinds.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// Name in tables.
            pub fn name(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }
        }
    };
}

kinds! {
    /// 50 dB, 12 bit, two half-cycles.
    Clean "clean",
    /// 30 dB.
    Clean30Db "clean, 30 dB",
    /// 8 bit.
    Clean8Bit "clean, 8 bit",
    /// 2.5 MS/s.
    CleanSlow "clean, 2.5 MS/s",
    /// One half-cycle, some of it missing.
    CleanShort "clean, .6-.9 of a half-cycle",
    /// Two half-cycles and a stub of a third.
    CleanStub "clean, with a stub",
    /// Five half-cycles.
    CleanLong "clean, five half-cycles",
    /// A bus that a capacitor holds.
    CleanHeld "clean, held bus",
    /// Offsets of both channels.
    CleanOffset "clean, offsets",
    /// Mains with harmonics and an asymmetrical duty.
    CleanMains "clean, distorted mains, duty .4",
    /// Neighbour at a multiple of twice the mains frequency from f_sw.
    NeighbourMultiple "neighbour, 2·f_mains multiple",
    /// Neighbour at any other offset below 600 Hz.
    NeighbourOdd "neighbour, odd offset",
    /// Neighbour whose bus is constant.
    NeighbourHeld "neighbour, constant",
    /// Neighbour from 600 Hz to 5 kHz.
    NeighbourFar "neighbour, .6-5 kHz",
    /// Two neighbours.
    NeighbourTwo "two neighbours",
    /// Neighbour below 50 Hz.
    NeighbourNear "neighbour, below 50 Hz",
    /// Skew of the channels.
    Skew "skew",
    /// Droop of the current.
    Droop "droop",
    /// Slow current probe.
    SlowProbe "slow probe",
    /// Gain of the current, with the capacitor known.
    Gain "gain, capacitor known",
    /// Clipped current.
    ClippedCurrent "clipped current",
    /// Clipped voltage.
    ClippedVoltage "clipped voltage",
    /// Saturating current sensor.
    Saturation "saturation",
    /// Samples missing without a trace.
    Lost "lost samples, unmarked",
    /// Samples missing in the stamps.
    LostStamped "lost samples, stamped",
    /// Jitter of the sampling.
    Jitter "jitter",
    /// Rate declared wrong by two.
    WrongRate "rate wrong by 2",
    /// A millisecond or two.
    TooShort "too short",
    /// Noise within the carrier's band.
    Coloured "coloured noise",
    /// White noise of 10 dB.
    Noise10Db "noise, 10 dB",
    /// 5 bit.
    Coarse "5 bit",
    /// Spikes.
    Spikes "spikes",
    /// Step of the load.
    LoadStep "load step",
    /// Moving pot.
    Drift "moving pot",
    /// Channels exchanged.
    Swapped "swapped",
    /// Probe reversed.
    Inverted "inverted",
    /// Step of the frequency.
    FrequencyStep "frequency step",
}

impl Kind {
    /// Returns `true` if nothing is wrong with such captures.
    pub fn is_sound(self) -> bool {
        self <= Self::CleanMains
    }
}

/// Circuit and sensors of one capture.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Circuit.
    pub circuit: Circuit,
    /// Sensors.
    pub sensors: Sensors,
}

impl Plan {
    /// Draws a plan.
    pub fn draw(kind: Kind, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1000) + kind as u64);
        let mut plan = Self::sound(&mut rng);
        plan.disturb(kind, &mut rng);
        plan
    }

    /// Two half-cycles of 50 Hz at 50 MS/s from a zero crossing on, with a pot that the seed draws; `snr_db` may be infinite. Without an
    /// eddy current, so that v = R i + L di/dt, by which R and L are defined, holds at each instant.
    pub fn of_pot(seed: u64, f_sw_hz: f64, snr_db: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let Self { mut circuit, .. } = Self::sound(&mut rng);
        circuit.load.eddy = 0.0;
        // The resonance stays at its share of the switching frequency.
        circuit.capacitance_f *= (circuit.bridge.f_sw_hz / f_sw_hz).powi(2);
        circuit.bridge = Bridge {
            f_sw_hz,
            mains_hz: 50.0,
            phase: 0.0,
            ..circuit.bridge
        };
        (circuit.rate_hz, circuit.duration_s) = (50e6, 0.02);
        let sensors = Sensors {
            bits: 24,
            snr_db,
            ..Sensors::default()
        };
        Self { circuit, sensors }
    }

    /// Integrates the circuit and records its waves, with noise of this seed.
    pub fn record(&self, seed: u64) -> Recorded {
        self.sensors
            .record(seed, &self.circuit, self.circuit.integrate())
    }

    fn sound(rng: &mut ChaCha8Rng) -> Self {
        let f_sw_hz = rng.random_range(36e3..72e3);
        let ferritic = rng.random_bool(0.75);
        let bend = |rng: &mut ChaCha8Rng, most: f64| {
            if ferritic {
                rng.random_range(0.3..1.0) * most
            } else {
                0.0
            }
        };
        let load = LoadLaw {
            r_ohm: (rng.random_range(1.5..4.0), bend(rng, 3.0)),
            l_h: (rng.random_range(17e-6..30e-6), bend(rng, 14e-6)),
            bend_a: rng.random_range(8.0..20.0),
            power: (rng.random_range(0.9..1.6), rng.random_range(1.0..1.8)),
            eddy: if rng.random_bool(0.5) { 0.7 } else { 0.0 },
        };
        let (_, l_h) = load.at(30.0);
        let resonance_hz = f_sw_hz * rng.random_range(0.55..0.8);
        let omega = std::f64::consts::TAU * resonance_hz;
        let bridge = Bridge {
            f_sw_hz,
            step: None,
            peak_v: rng.random_range(310.0..335.0),
            mains_hz: if rng.random_bool(0.7) { 50.0 } else { 60.0 } + rng.random_range(-0.1..0.1),
            phase: rng.random_range(0.0..std::f64::consts::PI),
            distortion: (0.0, 0.0),
            held: 0.0,
            edge_s: rng.random_range(0.15e-6..0.3e-6),
            duty: 0.5,
        };
        Self {
            circuit: Circuit {
                bridge,
                load,
                capacitance_f: 1.0 / (omega * omega * l_h),
                loop_r_ohm: 0.0,
                neighbours: Vec::new(),
                load_step: None,
                drift: (0.0, 0.0),
                rate_hz: if rng.random_bool(0.5) { 12.5e6 } else { 8e6 },
                duration_s: 1.0 / bridge.mains_hz,
            },
            sensors: Sensors {
                snr_db: rng.random_range(45.0..60.0),
                ..Sensors::default()
            },
        }
    }

    fn disturb(&mut self, kind: Kind, rng: &mut ChaCha8Rng) {
        let sign = |rng: &mut ChaCha8Rng| if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let Self { circuit, sensors } = self;
        let half_s = 0.5 / circuit.bridge.mains_hz;
        let mains_hz = circuit.bridge.mains_hz;
        let neighbour = |rng: &mut ChaCha8Rng, offset_hz: f64| Neighbour {
            offset_hz,
            v: rng.random_range(2.0..10.0),
            phase: rng.random_range(0.0..std::f64::consts::TAU),
            follows_mains: true,
        };
        match kind {
            Kind::Clean => {}
            Kind::Clean30Db => sensors.snr_db = 30.0,
            Kind::Clean8Bit => sensors.bits = 8,
            Kind::CleanSlow => circuit.rate_hz = 2.5e6,
            Kind::CleanShort => {
                let share = rng.random_range(0.6..0.9);
                circuit.duration_s = share * half_s;
                let begin = rng.random_range(0.0..1.0 - share);
                circuit.bridge.phase = std::f64::consts::PI * begin;
            }
            Kind::CleanStub => {
                let begin = rng.random_range(0.0..0.2);
                circuit.bridge.phase = std::f64::consts::PI * (1.0 - begin);
                circuit.duration_s = half_s * (2.0 + begin + rng.random_range(0.05..0.3));
            }
            Kind::CleanLong => circuit.duration_s = 5.0 * half_s,
            Kind::CleanHeld => circuit.bridge.held = rng.random_range(0.1..0.4),
            Kind::CleanOffset => {
                sensors.offset = (8.0 * sign(rng), 2.0 * sign(rng));
                sensors.headroom = (1.5, 1.5);
            }
            Kind::CleanMains => {
                circuit.bridge.distortion = (rng.random_range(-0.05..0.05), 0.02 * sign(rng));
                circuit.bridge.duty = 0.4;
            }
            Kind::NeighbourMultiple => {
                let order = f64::from(rng.random_range(1..=6));
                let offset_hz = 2.0 * mains_hz * order * sign(rng);
                circuit.neighbours = vec![neighbour(rng, offset_hz)];
            }
            Kind::NeighbourOdd => {
                let offset_hz = sign(rng) * rng.random_range(60.0..600.0);
                circuit.neighbours = vec![neighbour(rng, offset_hz)];
            }
            Kind::NeighbourHeld => {
                let offset_hz = sign(rng) * rng.random_range(60.0..2000.0);
                let other = neighbour(rng, offset_hz);
                circuit.neighbours = vec![Neighbour {
                    follows_mains: false,
                    ..other
                }];
            }
            Kind::NeighbourFar => {
                let offset_hz = sign(rng) * rng.random_range(600.0..5000.0);
                circuit.neighbours = vec![neighbour(rng, offset_hz)];
            }
            Kind::NeighbourTwo => {
                let (a, b) = (
                    rng.random_range(60.0..600.0),
                    rng.random_range(-1500.0..-100.0),
                );
                circuit.neighbours = vec![neighbour(rng, a), neighbour(rng, b)];
            }
            Kind::NeighbourNear => {
                let offset_hz = sign(rng) * rng.random_range(8.0..50.0);
                circuit.neighbours = vec![neighbour(rng, offset_hz)];
            }
            Kind::Skew => sensors.skew_s = sign(rng) * rng.random_range(30e-9..90e-9),
            Kind::Droop => sensors.droop_hz = Some(rng.random_range(300.0..3e3)),
            Kind::SlowProbe => sensors.slow_hz = Some(rng.random_range(100e3..700e3)),
            Kind::Gain => {
                sensors.gain.1 = 1.0 + sign(rng) * rng.random_range(0.02..0.08);
                sensors.capacitor_known = true;
            }
            Kind::ClippedCurrent => sensors.headroom.1 = rng.random_range(0.75..0.9),
            Kind::ClippedVoltage => sensors.headroom.0 = rng.random_range(0.75..0.9),
            Kind::Saturation => sensors.saturates_a = Some(rng.random_range(60.0..120.0)),
            Kind::Lost => {
                sensors.lost = vec![(rng.random_range(0.2..0.8), rng.random_range(5..40))];
            }
            Kind::LostStamped => {
                sensors.stamped = true;
                sensors.lost = vec![(rng.random_range(0.2..0.8), rng.random_range(5..400))];
            }
            Kind::Jitter => sensors.jitter_s = rng.random_range(5e-9..30e-9),
            Kind::WrongRate => sensors.wrong_rate = if rng.random_bool(0.5) { 2.0 } else { 0.5 },
            Kind::TooShort => {
                circuit.duration_s = rng.random_range(0.4e-3..2e-3);
            }
            Kind::Coloured => sensors.coloured = Some((rng.random_range(25.0..35.0), 0.3)),
            Kind::Noise10Db => sensors.snr_db = 10.0,
            Kind::Coarse => sensors.bits = 5,
            Kind::Spikes => sensors.spikes = rng.random_range(20..200),
            Kind::LoadStep => {
                let from_s = rng.random_range(0.2..0.8) * 2.0 * half_s;
                let by = rng.random_range(1.1..1.4);
                circuit.load_step = Some((from_s, by, 1.0 / by));
            }
            Kind::Drift => {
                circuit.drift = (4.0 * sign(rng), -3.0 * sign(rng));
            }
            Kind::Swapped => sensors.swapped = true,
            Kind::Inverted => sensors.inverted = true,
            Kind::FrequencyStep => {
                let hz = sign(rng) * rng.random_range(600.0..4000.0);
                circuit.bridge.step = Some((hz, rng.random_range(0.25..0.75) * 2.0 * half_s));
            }
        }
    }
}
