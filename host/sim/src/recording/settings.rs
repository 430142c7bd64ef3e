//! Settings of a recording, the paper's presets, and their limits.

use ihd_shared::hob::EDGE_NS;
use serde::{Deserialize, Serialize};

use super::sensing::Sensing;
use crate::inverter::{InverterError, in_range};
use crate::pot::{Metal, Pot};

/// Which model stands for the load.
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

/// Something that happens while recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// Another switching frequency in hertz.
    Frequency(f64),
    /// Another pot, or none.
    Pot(Pot),
    /// Bridge off: both switches open.
    Off,
    /// Bridge on.
    On,
}

/// A change and its time in seconds after the recording's start; it takes effect at the next
/// period of the switching frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// When, in seconds.
    pub t_s: f64,
    /// What.
    pub change: Change,
}

/// Everything that determines a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Switching frequency in hertz, 20 to 100 kHz.
    pub f_sw_hz: f64,
    /// Mains frequency in hertz, 50 or 60 usually.
    pub mains_hz: f64,
    /// Third, fifth and seventh harmonic of the mains as shares of its fundamental.
    pub mains_harmonics: [f64; 3],
    /// Bus capacitance in farad; 0: the bus is the rectified mains.
    pub bus_capacitance_f: f64,
    /// Dead time in seconds.
    pub dead_s: f64,
    /// Duration of the bridge's edges in seconds.
    pub edge_s: f64,
    /// What stands on the coil at the start.
    pub pot: Pot,
    /// How the load is modelled.
    pub load: LoadKind,
    /// Resistance of winding and leads in ohm, in series with a field model or its surrogate.
    pub winding_r_ohm: f64,
    /// Time after a mains zero crossing at which everything starts from rest, in seconds.
    pub start_s: f64,
    /// Length in seconds.
    pub duration_s: f64,
    /// Integration step in seconds; rounded so that a switching period is a whole number of steps.
    pub dt_s: f64,
    /// What happens meanwhile, in order of time.
    pub events: Vec<Event>,
    /// Sensing chain.
    pub sensing: Sensing,
    /// Seed of noise and spikes.
    pub seed: u64,
}

impl Default for Settings {
    /// The paper's time-domain simulation at 45 kHz: two mains half-cycles, no losses in the
    /// winding, no dead time, no noise.
    fn default() -> Self {
        Self {
            f_sw_hz: 45e3,
            mains_hz: 50.0,
            mains_harmonics: [0.0; 3],
            bus_capacitance_f: 0.0,
            dead_s: 0.0,
            edge_s: f64::from(EDGE_NS) * 1e-9,
            pot: Pot::new(Metal::Ferritic, 0.21),
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

/// A preset's name that means nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown preset `{0}`: use paper-45, paper-50, paper-60 or paper-70")]
pub struct UnknownPreset(String);

impl Settings {
    /// One of [`PRESETS`].
    pub fn preset(name: &str) -> Result<Self, UnknownPreset> {
        let found = PRESETS.iter().find(|(preset, _)| *preset == name);
        let (_, f_sw_hz) = found.ok_or_else(|| UnknownPreset(name.to_owned()))?;
        Ok(Self {
            f_sw_hz: *f_sw_hz,
            ..Self::default()
        })
    }

    /// Integration steps of a switching period at `f_sw_hz`.
    pub fn steps(&self, f_sw_hz: f64) -> usize {
        libm::round(1.0 / (f_sw_hz * self.dt_s)).max(8.0) as usize
    }

    /// Checks everything that is not checked where it is used; names the field.
    pub fn check(&self) -> Result<(), InverterError> {
        let f_range = "20 to 100 kHz";
        in_range("f_sw_hz", self.f_sw_hz, 20e3, 100e3, f_range)?;
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
            if let Change::Frequency(f) = event.change {
                in_range("event frequency_hz", f, 20e3, 100e3, f_range)?;
            }
        }
        self.sensing.check(self.edge_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_the_papers_frequencies_and_others_are_refused() {
        for (name, f) in PRESETS {
            let s = Settings::preset(name).unwrap();
            assert_eq!(s.f_sw_hz, f);
            assert_eq!(s.check(), Ok(()));
        }
        assert!(
            Settings::preset("paper-55")
                .unwrap_err()
                .to_string()
                .contains("paper-60")
        );
    }

    #[test]
    fn bad_numbers_are_refused_by_name() {
        let field = |change: fn(&mut Settings)| {
            let mut s = Settings::default();
            change(&mut s);
            s.check().unwrap_err().to_string()
        };
        assert!(field(|s| s.f_sw_hz = f64::NAN).contains("f_sw_hz"));
        assert!(field(|s| s.mains_hz = 0.0).contains("mains_hz"));
        assert!(field(|s| s.dt_s = 100e-9).contains("dt_s"));
        assert!(field(|s| s.sensing.bits = 7).contains("bits"));
        assert!(field(|s| s.duration_s = f64::INFINITY).contains("duration_s"));
        assert!(
            field(|s| s.events = vec![Event {
                t_s: 1.0,
                change: Change::Off
            }])
            .contains("event")
        );
    }
}
