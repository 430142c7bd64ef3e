//! Temperatures of heat sink, glass and coil, and the codes of their sensors.

use ihd_firmware::control::temperature::TemperatureCodes;
use ihd_shared::board;
use ihd_shared::hob::WINDING_R_OHM;

use crate::injection::{FaultChannel, InjectionKind, Injections};

/// Default temperature around the hob, in °C.
pub const AMBIENT_C: f64 = 25.0;

/// Voltage across the conducting switch or diode, in volt: 1.7 V of an IGBT of 650 V and 40 A at 25 A.
const SWITCH_V: f64 = 1.7;

/// Voltage across the mains rectifier's two diodes, in volt; the resistance in the board's file is fuse's and choke's too, beside the heat sink.
const RECTIFIER_V: f64 = board::RECTIFIER_MV as f64 * 1e-3;

/// Heat capacity of 0.28 kg of aluminium, in J/K.
const SINK_J_PER_K: f64 = 250.0;

/// Thermal conductance from the heat sink to the air, in W/K: with the fan, and without.
const SINK_W_PER_K: (f64, f64) = (1.7, 0.4);

/// Heat capacity of a glass ceramic of 4 mm under a pot of 21 cm: 0.35 kg, in J/K.
pub(super) const GLASS_J_PER_K: f64 = 280.0;

/// Thermal conductances from the pot's base to the glass, from the glass to the air, and from the glass to the coil, in W/K.
pub(super) const GLASS_W_PER_K: (f64, f64, f64) = (8.0, 1.0, 0.5);

/// Lag of the glass's sensor behind the glass in seconds: d²/2a = 10 s from the middle of 4 mm of glass ceramic to a bead below it,
/// its own included.
const GLASS_SENSOR_S: f64 = 10.0;

/// Rise of copper's resistance for each kelvin, of that at 20 °C, and so of the winding's.
const COPPER_PER_K: f64 = 0.003_93;

/// Heat capacity of litz wire and carrier, in J/K.
pub(super) const COIL_J_PER_K: f64 = 200.0;

/// Thermal conductance from the coil to the air, in W/K: with the fan, and without.
const COIL_W_PER_K: (f64, f64) = (1.2, 0.4);

/// Heat sources over a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Heat {
    /// Mean of the coil current's magnitude, in ampere.
    pub i_mean_a: f64,
    /// Mean of its square, in ampere squared.
    pub i_square_a2: f64,
    /// Mean current from the rectifier, in ampere.
    pub mains_a: f64,
    /// Energy of hard edges, in joule.
    pub edges_j: f64,
    /// Heat from the pot into the glass, in joule.
    pub glass_j: f64,
}

/// Temperatures of three lumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LumpTemperatures {
    /// Temperature around the hob, in °C.
    pub ambient_c: f64,
    /// Temperature of the heat sink of switches and rectifier, in °C.
    pub heat_sink_c: f64,
    /// Temperature of the glass, in °C.
    pub glass_c: f64,
    /// Temperature of the glass's sensor, in °C.
    pub glass_sensor_c: f64,
    /// Temperature of the coil, in °C.
    pub coil_c: f64,
}

impl LumpTemperatures {
    /// Creates lumps at the temperature around the hob, in °C.
    pub fn at(ambient_c: f64) -> Self {
        Self {
            ambient_c,
            heat_sink_c: ambient_c,
            glass_c: ambient_c,
            glass_sensor_c: ambient_c,
            coil_c: ambient_c,
        }
    }

    /// Sets the glass and its sensor to a temperature in °C.
    pub fn set_glass(&mut self, celsius: f64) {
        self.glass_c = celsius;
        self.glass_sensor_c = celsius;
    }

    /// Advances by `dt_s`, which must be short against seconds.
    pub fn advance(&mut self, dt_s: f64, heat: &Heat, fan: bool) {
        let air = |(with, without): (f64, f64)| if fan { with } else { without };
        let Self {
            ambient_c,
            heat_sink_c,
            glass_c,
            coil_c,
            glass_sensor_c,
        } = *self;
        let lost_w = SWITCH_V * heat.i_mean_a + RECTIFIER_V * heat.mains_a;
        let sink_w = lost_w - air(SINK_W_PER_K) * (heat_sink_c - ambient_c);
        let (_, to_air, to_coil) = GLASS_W_PER_K;
        let down_w = to_coil * (glass_c - coil_c);
        let glass_w = -to_air * (glass_c - ambient_c) - down_w;
        let copper_w = winding_r_ohm(coil_c) * heat.i_square_a2;
        let coil_w = copper_w + down_w - air(COIL_W_PER_K) * (coil_c - ambient_c);
        self.heat_sink_c += (sink_w * dt_s + heat.edges_j) / SINK_J_PER_K;
        self.glass_c += (glass_w * dt_s + heat.glass_j) / GLASS_J_PER_K;
        self.glass_sensor_c += (glass_c - glass_sensor_c) * dt_s / GLASS_SENSOR_S;
        self.coil_c += coil_w * dt_s / COIL_J_PER_K;
    }

    /// Codes of the sensors: NTCs below a resistor to the reference.
    pub fn codes(&self, injections: &Injections) -> TemperatureCodes {
        let celsius = [self.heat_sink_c, self.glass_sensor_c, self.coil_c];
        let [heat_sink, glass, coil] =
            [0, 1, 2].map(|place| Some(ntc_code(place, celsius[place], injections)));
        TemperatureCodes {
            heat_sink,
            glass,
            coil,
        }
    }
}

/// Resistance of the winding at a temperature in °C, in ohm; the board file's is that of a cold one, of [`AMBIENT_C`].
pub fn winding_r_ohm(coil_c: f64) -> f64 {
    let over_20c = |c: f64| 1.0 + COPPER_PER_K * (c - 20.0);
    WINDING_R_OHM * over_20c(coil_c) / over_20c(AMBIENT_C)
}

/// Code of the NTC at a place in [`NTCS`], at a temperature in °C, with its injected fault.
pub fn ntc_code(place: usize, celsius: f64, injections: &Injections) -> u16 {
    let channels = [
        FaultChannel::HeatSink,
        FaultChannel::Glass,
        FaultChannel::Coil,
    ];
    match injections.ntc(channels[place]) {
        Some(InjectionKind::NtcOpen) => 4_095,
        Some(_) => 0,
        None => NTCS[place].code(celsius),
    }
}

/// NTC to ground, with its resistor to the converter's reference.
#[derive(Clone, Copy, Debug)]
pub struct Ntc {
    ohm_at_25c: u32,
    b_k: u32,
    pull_up_ohm: u32,
}

/// The board's, of heat sink, glass and coil.
pub const NTCS: [Ntc; 3] = [
    Ntc {
        ohm_at_25c: board::HEAT_SINK_NTC_OHM,
        b_k: board::HEAT_SINK_NTC_B_K,
        pull_up_ohm: board::HEAT_SINK_PULL_UP_OHM,
    },
    Ntc {
        ohm_at_25c: board::GLASS_NTC_OHM,
        b_k: board::GLASS_NTC_B_K,
        pull_up_ohm: board::GLASS_PULL_UP_OHM,
    },
    Ntc {
        ohm_at_25c: board::COIL_NTC_OHM,
        b_k: board::COIL_NTC_B_K,
        pull_up_ohm: board::COIL_PULL_UP_OHM,
    },
];

impl Ntc {
    /// Code of 12 bit at a temperature in °C.
    pub fn code(self, celsius: f64) -> u16 {
        let colder = 1.0 / (celsius + 273.15) - 1.0 / 298.15;
        let ohm = f64::from(self.ohm_at_25c) * libm::exp(f64::from(self.b_k) * colder);
        let code = 4_096.0 * ohm / (ohm + f64::from(self.pull_up_ohm));
        code.round().min(4_095.0) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::injection::Injection;

    fn settled(heat: &Heat, fan: bool) -> LumpTemperatures {
        let mut t = LumpTemperatures::at(AMBIENT_C);
        for _ in 0..200_000 {
            // A pot's base of 110 °C.
            let glass_j = 0.1 * GLASS_W_PER_K.0 * (110.0 - t.glass_c);
            t.advance(0.1, &Heat { glass_j, ..*heat }, fan);
        }
        t
    }

    #[test]
    fn at_rated_power_the_fan_makes_the_difference() {
        let heat = Heat {
            i_mean_a: 20.0,
            i_square_a2: 550.0,
            mains_a: 11.0,
            edges_j: 0.0,
            glass_j: 0.0,
        };
        let (with, without) = (settled(&heat, true), settled(&heat, false));
        // (1.7·20 + 1.8·11) W over 1.7 and 0.4 W/K.
        assert!(
            (with.heat_sink_c - (25.0 + 53.8 / 1.7)).abs() < 0.1,
            "{with:?}"
        );
        assert!((without.heat_sink_c - (25.0 + 53.8 / 0.4)).abs() < 0.1);
        assert!((60.0..110.0).contains(&with.coil_c), "{with:?}");
        assert!((85.0..105.0).contains(&with.glass_c), "{with:?}");
    }

    #[test]
    fn a_winding_of_copper_has_a_third_more_resistance_at_100_c() {
        // 1 + 0.00393 · 80 over 1 + 0.00393 · 5.
        let ratio = winding_r_ohm(100.0) / WINDING_R_OHM;
        assert!((ratio - 1.3144 / 1.01965).abs() < 1e-6, "{ratio}");
    }

    #[test]
    fn the_firmware_reads_its_own_temperatures_back() {
        let t = LumpTemperatures {
            heat_sink_c: 63.0,
            glass_sensor_c: 141.0,
            coil_c: 98.0,
            ..LumpTemperatures::at(AMBIENT_C)
        };
        let mut read = ihd_firmware::control::temperature::Temperatures::default();
        read.update(t.codes(&Injections::default()));
        let got = read.celsius().map(|c| f64::from(c.unwrap()));
        for (got, is) in got.into_iter().zip([63.0, 141.0, 98.0]) {
            assert!((got - is).abs() < 2.5, "{got} {is}");
        }
    }

    #[test]
    fn a_broken_and_a_shorted_sensor_have_the_codes_of_the_ends() {
        let mut injections = Injections::default();
        for (kind, channel) in [
            (InjectionKind::NtcOpen, FaultChannel::Glass),
            (InjectionKind::NtcShort, FaultChannel::HeatSink),
        ] {
            injections.start(Injection {
                kind,
                value: 0.0,
                channel,
            });
        }
        let codes = LumpTemperatures::at(AMBIENT_C).codes(&injections);
        assert_eq!((codes.glass, codes.heat_sink), (Some(4_095), Some(0)));
        let (ntc, all) = (
            board::COIL_NTC_OHM,
            board::COIL_NTC_OHM + board::COIL_PULL_UP_OHM,
        );
        let half = 4_096.0 * f64::from(ntc) / f64::from(all);
        assert_eq!(codes.coil, Some(half.round() as u16), "at 25 °C");
    }
}
