//! Settings of the sensing chain, and their limits.

use serde::{Deserialize, Serialize};

use crate::inverter::{InverterError, in_range};

/// Sampling rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rate {
    /// f_sw · 61/3, as the board does.
    Locked,
    /// A fixed rate in hertz, as an oscilloscope does.
    Hz(f64),
}

/// Sensing chain between the coil and the numbers. Fields missing in a file have the values of [`Sensing::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Sensing {
    /// Sampling.
    pub rate: Rate,
    /// `true` to accept a fixed rate that cannot show the voltage's edges.
    pub allow_aliasing: bool,
    /// Resolution, 8 to 16 bits.
    pub bits: u32,
    /// Half the voltage range in volt.
    pub v_full_scale_v: f64,
    /// Half the current range in ampere.
    pub i_full_scale_a: f64,
    /// Gain of the voltage channel, 1 is right.
    pub v_gain: f64,
    /// Gain of the current channel, 1 is right.
    pub i_gain: f64,
    /// Offset of the voltage channel in volt.
    pub v_offset_v: f64,
    /// Offset of the current channel in ampere.
    pub i_offset_a: f64,
    /// Corner of the first-order anti-alias filter in hertz; 0: none.
    pub pole_hz: f64,
    /// Corner of a first-order low pass that the voltage channel alone has, in hertz, 10 kHz to
    /// 100 MHz: a probe's bandwidth; 0: none.
    pub v_pole_hz: f64,
    /// Corner of a first-order low pass that the current channel alone has, in hertz, 10 kHz to 100 MHz; 0: none.
    pub i_pole_hz: f64,
    /// Corner of a first-order high pass in the current channel in hertz, 1 Hz to 50 kHz: the droop of
    /// a current transformer or a Rogowski coil's integrator; 0: none.
    pub i_droop_hz: f64,
    /// Soft saturation of the current probe: it shows s·tanh(i/s), with s this in ampere, 1 to 10000;
    /// 0: none.
    pub i_saturation_a: f64,
    /// Delay of the current's samples after the voltage's, in seconds.
    pub skew_s: f64,
    /// White noise on both channels: SNR in decibel, σ² = P_signal/10^(SNR/10) (paper, section V).
    pub snr_db: Option<f64>,
    /// Switching ringing on the voltage, as a share of each edge; 0: none.
    pub ringing: f64,
    /// Frequency of the ringing in hertz.
    pub ringing_hz: f64,
    /// Decay time of the ringing in seconds.
    pub ringing_decay_s: f64,
    /// Spikes per second on each channel, single samples off by up to a quarter of the range.
    pub spikes_per_s: f64,
}

impl Default for Sensing {
    /// An oscilloscope of 50 MS/s and 16 bits, without any error.
    fn default() -> Self {
        Self {
            rate: Rate::Hz(50e6),
            allow_aliasing: false,
            bits: 16,
            v_full_scale_v: 640.0,
            i_full_scale_a: 80.0,
            v_gain: 1.0,
            i_gain: 1.0,
            v_offset_v: 0.0,
            i_offset_a: 0.0,
            pole_hz: 0.0,
            v_pole_hz: 0.0,
            i_pole_hz: 0.0,
            i_droop_hz: 0.0,
            i_saturation_a: 0.0,
            skew_s: 0.0,
            snr_db: None,
            ringing: 0.0,
            ringing_hz: 3.5e6,
            ringing_decay_s: 0.4e-6,
            spikes_per_s: 0.0,
        }
    }
}

impl Sensing {
    /// Checks every number; `edge_s` is the duration of the bridge's edges.
    pub fn check(&self, edge_s: f64) -> Result<(), InverterError> {
        if let Rate::Hz(rate_hz) = self.rate {
            in_range("rate_hz", rate_hz, 1e5, 1e9, "0.1 to 1000 MS/s")?;
            if !self.allow_aliasing && rate_hz * edge_s < 2.0 {
                return Err(InverterError::OutOfRange {
                    field: "rate_hz",
                    value: rate_hz,
                    allowed: "at least two samples an edge (10 MS/s for 0.2 µs), or locked; aliasing must be allowed on purpose",
                });
            }
        }
        in_range("bits", f64::from(self.bits), 8.0, 16.0, "8 to 16")?;
        in_range(
            "v_full_scale_v",
            self.v_full_scale_v,
            1.0,
            1e5,
            "1 V to 100 kV",
        )?;
        in_range(
            "i_full_scale_a",
            self.i_full_scale_a,
            0.1,
            1e4,
            "0.1 A to 10 kA",
        )?;
        in_range("v_gain", self.v_gain, 0.1, 10.0, "0.1 to 10")?;
        in_range("i_gain", self.i_gain, 0.1, 10.0, "0.1 to 10")?;
        in_range("v_offset_v", self.v_offset_v, -1e3, 1e3, "-1000 to 1000 V")?;
        in_range("i_offset_a", self.i_offset_a, -1e3, 1e3, "-1000 to 1000 A")?;
        if self.pole_hz != 0.0 {
            in_range("pole_hz", self.pole_hz, 1e4, 5e6, "0, or 10 kHz to 5 MHz")?;
        }
        self.check_probes()?;
        in_range("skew_s", self.skew_s, -10e-6, 10e-6, "-10 to 10 µs")?;
        if let Some(snr_db) = self.snr_db {
            in_range("snr_db", snr_db, -20.0, 200.0, "-20 to 200 dB")?;
        }
        in_range("ringing", self.ringing, 0.0, 1.0, "0 to 1")?;
        in_range("ringing_hz", self.ringing_hz, 1e5, 10e6, "0.1 to 10 MHz")?;
        in_range(
            "ringing_decay_s",
            self.ringing_decay_s,
            1e-8,
            1e-4,
            "10 ns to 100 µs",
        )?;
        in_range("spikes_per_s", self.spikes_per_s, 0.0, 1e6, "0 to 1e6")
    }

    fn check_probes(&self) -> Result<(), InverterError> {
        let own_pole = "0, or 10 kHz to 100 MHz";
        for (field, corner_hz) in [("v_pole_hz", self.v_pole_hz), ("i_pole_hz", self.i_pole_hz)] {
            if corner_hz != 0.0 {
                in_range(field, corner_hz, 1e4, 1e8, own_pole)?;
            }
        }
        if self.i_droop_hz != 0.0 {
            let droop = "0, or 1 Hz to 50 kHz";
            in_range("i_droop_hz", self.i_droop_hz, 1.0, 50e3, droop)?;
        }
        if self.i_saturation_a != 0.0 {
            let saturation = "0, or 1 A to 10 kA";
            in_range("i_saturation_a", self.i_saturation_a, 1.0, 1e4, saturation)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_from_before_the_probes_is_read_as_without_them() {
        let mut old = serde_json::to_value(Sensing::default()).unwrap();
        let fields = old.as_object_mut().unwrap();
        for new in ["v_pole_hz", "i_pole_hz", "i_droop_hz", "i_saturation_a"] {
            assert!(fields.remove(new).is_some(), "{new}");
        }
        let back: Sensing = serde_json::from_value(old).unwrap();
        assert_eq!(back, Sensing::default());
    }

    #[test]
    fn impossible_probes_are_refused_by_name() {
        let refused = |change: fn(&mut Sensing)| {
            let mut s = Sensing::default();
            change(&mut s);
            s.check(0.2e-6).unwrap_err().to_string()
        };
        assert!(refused(|s| s.i_pole_hz = 1.0).contains("i_pole_hz"));
        assert!(refused(|s| s.v_pole_hz = f64::NAN).contains("v_pole_hz"));
        assert!(refused(|s| s.i_droop_hz = -1.0).contains("i_droop_hz"));
        assert!(refused(|s| s.i_saturation_a = 0.1).contains("i_saturation_a"));
    }

    #[test]
    fn a_rate_below_the_edges_is_refused_unless_meant() {
        let mut s = Sensing {
            rate: Rate::Hz(1e6),
            ..Sensing::default()
        };
        assert!(s.check(0.2e-6).unwrap_err().to_string().contains("rate_hz"));
        s.allow_aliasing = true;
        assert_eq!(s.check(0.2e-6), Ok(()));
        s.rate = Rate::Hz(f64::NAN);
        assert!(s.check(0.2e-6).is_err());
    }
}
