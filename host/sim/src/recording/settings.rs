//! Specification of a recording, the paper's presets, and their limits.

use std::f64::consts::TAU;

use ihd_shared::hob::EDGE_NS;
use serde::{Deserialize, Serialize};

use super::sensing::Sensing;
use crate::inverter::supply::SupplyParts;
use crate::inverter::{InverterError, in_range};
use crate::pot::{PotBase, SimulatedPot};

/// Load model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadKind {
    /// Nonlinear diffusion, in time.
    Field,
    /// A table fitted to the field model: v = R i + L di/dt holds. `reduced` in files and on the
    /// command line.
    #[serde(rename = "reduced", alias = "surrogate")]
    Surrogate,
    /// Closed formulas, the behavioural reference load of the studies: v = R i + L di/dt holds.
    Behavioural,
}

/// Change during a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingChange {
    /// Another switching frequency in hertz.
    Frequency(f64),
    /// Another pot, or none.
    Pot(SimulatedPot),
    /// Bridge off: both switches open.
    Off,
    /// Bridge on.
    On,
    /// Sets the factors of a law's R and L until the next such change.
    Load {
        /// Factor of R, 0.1 to 10.
        r_factor: f64,
        /// Factor of L, 0.1 to 10.
        l_factor: f64,
    },
}

/// Moving carrier: f_sw(t) = f + deviation · sin(2π · rate · t), t since the recording's start, constant within a switching period.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CarrierSweep {
    /// Largest deviation in hertz, 0 to 10 kHz.
    pub deviation_hz: f64,
    /// Frequency of the modulation in hertz, 1 to 5000.
    pub rate_hz: f64,
}

/// Nearby hob zone whose field induces a sine in the coil.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// Its frequency less that of the recording's start, in hertz, -50 to 50 kHz.
    pub offset_hz: f64,
    /// Amplitude of the induced voltage in volt, 0 to 200.
    pub v: f64,
}

/// Change at a time in seconds after the recording's start; it takes effect at the next period of the switching frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingEvent {
    /// Time in seconds.
    pub t_s: f64,
    /// Change.
    pub change: RecordingChange,
}

/// Complete specification of a recording. Fields missing in a file have the values of [`CaptureSpec::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CaptureSpec {
    /// Switching frequency in hertz, 20 to 100 kHz.
    pub f_sw_hz: f64,
    /// Modulation of the switching frequency.
    pub sweep: Option<CarrierSweep>,
    /// Share of the period in which the upper switch is on, 0.2 to 0.8; 0.5 is the hob's.
    pub duty: f64,
    /// Resistance of the bridge's switches in ohm, 0 to 1: in the loop, outside the coil.
    pub bridge_r_ohm: f64,
    /// Neighbouring zone whose field acts on the coil.
    pub neighbour: Option<Neighbour>,
    /// Mains frequency in hertz, 50 or 60 usually.
    pub mains_hz: f64,
    /// Third, fifth and seventh harmonic of the mains as shares of its fundamental.
    pub mains_harmonics: [f64; 3],
    /// Bus capacitance in farad; 0: the bus is the rectified mains.
    pub bus_capacitance_f: f64,
    /// Inductance of the line in henry, with a bus capacitance; 0: the line is a resistance.
    pub line_l_h: f64,
    /// Dead time in seconds.
    pub dead_s: f64,
    /// Duration of the bridge's edges in seconds.
    pub edge_s: f64,
    /// Pot on the coil at the start.
    pub pot: SimulatedPot,
    /// Load model.
    pub load: LoadKind,
    /// Resistance of winding and leads in ohm, in series with a field model or its surrogate.
    pub winding_r_ohm: f64,
    /// Time after a mains zero crossing at which everything starts from rest, in seconds.
    pub start_s: f64,
    /// Length in seconds.
    pub duration_s: f64,
    /// Integration step in seconds; rounded so that a switching period is a whole number of steps.
    pub dt_s: f64,
    /// Changes, in order of time.
    pub events: Vec<RecordingEvent>,
    /// Sensing chain.
    pub sensing: Sensing,
    /// Seed of noise and spikes.
    pub seed: u64,
}

impl Default for CaptureSpec {
    /// The paper's time-domain simulation at 45 kHz: two mains half-cycles, no losses in the
    /// winding, no dead time, no noise.
    fn default() -> Self {
        Self {
            f_sw_hz: 45e3,
            sweep: None,
            duty: 0.5,
            bridge_r_ohm: 0.0,
            neighbour: None,
            mains_hz: 50.0,
            mains_harmonics: [0.0; 3],
            bus_capacitance_f: 0.0,
            line_l_h: 0.0,
            dead_s: 0.0,
            edge_s: f64::from(EDGE_NS) * 1e-9,
            pot: SimulatedPot::new(PotBase::Ferritic, 0.21),
            load: LoadKind::Field,
            winding_r_ohm: 0.0,
            start_s: 0.0,
            duration_s: 20e-3,
            dt_s: 20e-9,
            events: Vec::new(),
            sensing: Sensing::default(),
            seed: 1,
        }
    }
}

/// Names of the paper's operating points.
pub const PRESETS: [(&str, f64); 4] = [
    ("paper-45", 45e3),
    ("paper-50", 50e3),
    ("paper-60", 60e3),
    ("paper-70", 70e3),
];

/// A name that denotes no preset.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown preset `{0}`: use paper-45, paper-50, paper-60 or paper-70")]
pub struct UnknownPreset(String);

impl CaptureSpec {
    /// Returns one of [`PRESETS`].
    pub fn preset(name: &str) -> Result<Self, UnknownPreset> {
        let found = PRESETS.iter().find(|(preset, _)| *preset == name);
        let (_, f_sw_hz) = found.ok_or_else(|| UnknownPreset(name.to_owned()))?;
        Ok(Self {
            f_sw_hz: *f_sw_hz,
            ..Self::default()
        })
    }

    /// Parts between mains and bridge: the schematic's with an inductance of the line, else an ideal rectifier.
    pub fn supply(&self) -> SupplyParts {
        let link_capacitance_f = self.bus_capacitance_f;
        if self.line_l_h == 0.0 {
            return SupplyParts::stiff(link_capacitance_f);
        }
        SupplyParts {
            link_capacitance_f,
            line_l_h: self.line_l_h,
            ..SupplyParts::SCHEMATIC
        }
    }

    /// Integration steps of a switching period at `f_sw_hz`.
    pub fn steps(&self, f_sw_hz: f64) -> usize {
        libm::round(1.0 / (f_sw_hz * self.dt_s)).max(8.0) as usize
    }

    /// Switching frequency in hertz at `t_s` after the start, if the hob is set to `f_sw_hz`.
    pub fn swept_hz(&self, f_sw_hz: f64, t_s: f64) -> f64 {
        self.sweep.map_or(f_sw_hz, |s| {
            f_sw_hz + s.deviation_hz * libm::sin(TAU * s.rate_hz * t_s)
        })
    }

    /// Checks all values that are not checked at their use; the error names the field.
    pub fn check(&self) -> Result<(), InverterError> {
        self.check_frequency("f_sw_hz", self.f_sw_hz)?;
        self.check_disturbances()?;
        in_range("mains_hz", self.mains_hz, 40.0, 70.0, "40 to 70 Hz")?;
        for share in self.mains_harmonics {
            in_range("mains_harmonics", share, -0.2, 0.2, "-0.2 to 0.2")?;
        }
        in_range(
            "winding_r_ohm",
            self.winding_r_ohm,
            0.0,
            10.0,
            "0 to 10 ohm",
        )?;
        in_range("start_s", self.start_s, 0.0, 1.0, "0 to 1 s")?;
        in_range("duration_s", self.duration_s, 1e-4, 10.0, "0.1 ms to 10 s")?;
        in_range("edge_s", self.edge_s, 10e-9, 2e-6, "10 ns to 2 µs")?;
        if !(1e-9..=0.25 * self.edge_s).contains(&self.dt_s) {
            return Err(InverterError::OutOfRange {
                field: "dt_s",
                value: self.dt_s,
                allowed: "1 ns to a quarter of the edge (50 ns for 0.2 µs)",
            });
        }
        self.check_behavioural()?;
        self.check_events()?;
        self.sensing.check(self.edge_s)
    }

    /// Checks that nothing is asked of a behavioural load that it has not: it is one curve for each metal.
    fn check_behavioural(&self) -> Result<(), InverterError> {
        if self.load != LoadKind::Behavioural {
            return Ok(());
        }
        for (field, value, only) in [
            ("lift_m", self.pot.lift_m, 0.0),
            ("offset_m", self.pot.offset_m, 0.0),
            ("temperature_c", self.pot.temperature_c, 20.0),
            ("winding_r_ohm", self.winding_r_ohm, 0.0),
        ] {
            let allowed = "left out, as a behavioural load does not have it; load=reduced does";
            in_range(field, value, only, only, allowed)?;
        }
        Ok(())
    }

    /// Checks a switching frequency, with the modulation around it.
    fn check_frequency(&self, field: &'static str, f_sw_hz: f64) -> Result<(), InverterError> {
        let deviation_hz = self.sweep.map_or(0.0, |s| s.deviation_hz);
        let (from_hz, to_hz) = (20e3 + deviation_hz, 100e3 - deviation_hz);
        let allowed = "20 to 100 kHz, the sweep included";
        in_range(field, f_sw_hz, from_hz, to_hz, allowed)
    }

    fn check_disturbances(&self) -> Result<(), InverterError> {
        if let Some(sweep) = self.sweep {
            let deviation_hz = sweep.deviation_hz;
            in_range("sweep deviation_hz", deviation_hz, 0.0, 10e3, "0 to 10 kHz")?;
            in_range("sweep rate_hz", sweep.rate_hz, 1.0, 5e3, "1 to 5000 Hz")?;
        }
        if let Some(neighbour) = self.neighbour {
            let offset_hz = neighbour.offset_hz;
            let allowed = "-50 to 50 kHz";
            in_range("neighbour offset_hz", offset_hz, -50e3, 50e3, allowed)?;
            in_range("neighbour v", neighbour.v, 0.0, 200.0, "0 to 200 V")?;
        }
        in_range("duty", self.duty, 0.2, 0.8, "0.2 to 0.8")?;
        in_range("bridge_r_ohm", self.bridge_r_ohm, 0.0, 1.0, "0 to 1 ohm")
    }

    fn check_events(&self) -> Result<(), InverterError> {
        let mut last_s = 0.0;
        for event in &self.events {
            in_range(
                "event time_s",
                event.t_s,
                last_s,
                self.duration_s,
                "in order, within the recording",
            )?;
            last_s = event.t_s;
            match event.change {
                RecordingChange::Frequency(f) => self.check_frequency("event frequency_hz", f)?,
                RecordingChange::Load { r_factor, l_factor } => {
                    // The field model has no R and L to scale.
                    let (least, most) = match self.load {
                        LoadKind::Field => (1.0, 1.0),
                        LoadKind::Surrogate | LoadKind::Behavioural => (0.1, 10.0),
                    };
                    let allowed = "0.1 to 10, with a reduced or behavioural load";
                    in_range("event r_factor", r_factor, least, most, allowed)?;
                    in_range("event l_factor", l_factor, least, most, allowed)?;
                }
                RecordingChange::Pot(_) | RecordingChange::Off | RecordingChange::On => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_the_papers_frequencies_and_others_are_refused() {
        for (name, f) in PRESETS {
            let s = CaptureSpec::preset(name).unwrap();
            assert_eq!(s.f_sw_hz, f);
            assert_eq!(s.check(), Ok(()));
        }
        assert!(
            CaptureSpec::preset("paper-55")
                .unwrap_err()
                .to_string()
                .contains("paper-60")
        );
    }

    #[test]
    fn what_a_behavioural_load_does_not_have_is_refused() {
        for change in [
            (|s| s.pot.lift_m = 0.02) as fn(&mut CaptureSpec),
            |s| s.pot.offset_m = 0.03,
            |s| s.pot.temperature_c = 300.0,
            |s| s.winding_r_ohm = 0.5,
        ] {
            let mut s = CaptureSpec {
                load: LoadKind::Behavioural,
                ..CaptureSpec::default()
            };
            assert_eq!(s.check(), Ok(()));
            change(&mut s);
            assert!(s.check().is_err(), "{s:?}");
            s.load = LoadKind::Surrogate;
            assert_eq!(s.check(), Ok(()));
        }
    }

    #[test]
    fn settings_from_before_the_disturbances_are_read_as_without_them() {
        let mut old = serde_json::to_value(CaptureSpec::default()).unwrap();
        let fields = old.as_object_mut().unwrap();
        for new in ["sweep", "duty", "bridge_r_ohm", "neighbour"] {
            assert!(fields.remove(new).is_some(), "{new}");
        }
        let back: CaptureSpec = serde_json::from_value(old).unwrap();
        assert_eq!(back, CaptureSpec::default());
        let all = CaptureSpec {
            sweep: Some(CarrierSweep {
                deviation_hz: 5e3,
                rate_hz: 100.0,
            }),
            neighbour: Some(Neighbour {
                offset_hz: 1.2e3,
                v: 8.0,
            }),
            load: LoadKind::Behavioural,
            events: vec![RecordingEvent {
                t_s: 1e-3,
                change: RecordingChange::Load {
                    r_factor: 0.6,
                    l_factor: 1.35,
                },
            }],
            ..CaptureSpec::default()
        };
        assert_eq!(all.check(), Ok(()));
        let text = serde_json::to_string(&all).unwrap();
        assert_eq!(serde_json::from_str::<CaptureSpec>(&text).unwrap(), all);
    }

    #[test]
    fn impossible_disturbances_are_refused_by_name() {
        let field = |change: fn(&mut CaptureSpec)| {
            let mut s = CaptureSpec::default();
            change(&mut s);
            s.check().unwrap_err().to_string()
        };
        assert!(
            field(|s| s.sweep = Some(CarrierSweep {
                deviation_hz: 1e3,
                rate_hz: 0.0
            }))
            .contains("rate_hz")
        );
        assert!(field(|s| s.bridge_r_ohm = -0.1).contains("bridge_r_ohm"));
        // 22 kHz less 3 kHz are below the lowest frequency.
        assert!(
            field(|s| {
                s.f_sw_hz = 22e3;
                s.sweep = Some(CarrierSweep {
                    deviation_hz: 3e3,
                    rate_hz: 100.0,
                });
            })
            .contains("f_sw_hz")
        );
        // The field model has no R and L to scale.
        assert!(
            field(|s| s.events = vec![RecordingEvent {
                t_s: 1e-3,
                change: RecordingChange::Load {
                    r_factor: 2.0,
                    l_factor: 1.0
                },
            }])
            .contains("r_factor")
        );
    }

    #[test]
    fn bad_numbers_are_refused_by_name() {
        let field = |change: fn(&mut CaptureSpec)| {
            let mut s = CaptureSpec::default();
            change(&mut s);
            s.check().unwrap_err().to_string()
        };
        assert!(field(|s| s.f_sw_hz = f64::NAN).contains("f_sw_hz"));
        assert!(field(|s| s.mains_hz = 0.0).contains("mains_hz"));
        assert!(field(|s| s.dt_s = 100e-9).contains("dt_s"));
        assert!(field(|s| s.sensing.bits = 7).contains("bits"));
        assert!(field(|s| s.duration_s = f64::INFINITY).contains("duration_s"));
        assert!(
            field(|s| s.events = vec![RecordingEvent {
                t_s: 1.0,
                change: RecordingChange::Off
            }])
            .contains("event")
        );
    }
}
