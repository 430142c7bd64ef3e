//! Temperatures of heat sink, glass and coil: from NTC codes to °C, to the power that is left, to the
//! fan.
//!
//! Each NTC lies between the converter's input and ground, with a resistor to the converter's reference; the board's file has
//! both. A line between table entries of 10 K is off by less than 0.5 K.

use ihd_shared::board::{NTC_CODES, NTC_FROM_C, NTC_SHORT_BELOW, NTC_STEP_C};
use ihd_shared::fault::Fault;

use crate::limits::{
    COIL_DERATE_C, COIL_OFF_C, FAN_OFF_C, FAN_ON_C, GLASS_COOL_C, GLASS_DERATE_C, GLASS_HOT_C,
    GLASS_OFF_C, SINK_DERATE_C, SINK_OFF_C,
};

/// Codes of the board's sensors; a constant would be copied wherever it is used.
static CODES: [[u16; ENTRIES]; 3] = NTC_CODES;
const ENTRIES: usize = NTC_CODES[0].len();

/// Codes of one sensor; `None` where none is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TemperatureCodes {
    /// Heat sink's sensor, code of 12 bit; `None` if not fitted.
    pub heat_sink: Option<u16>,
    /// Glass's sensor.
    pub glass: Option<u16>,
    /// Coil's sensor.
    pub coil: Option<u16>,
}

/// Temperatures in °C, and what follows from them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Temperatures {
    heat_sink_c: Option<i16>,
    /// In 1/16 °C.
    glass: Option<i32>,
    coil_c: Option<i16>,
    fault: Fault,
    fan: bool,
    glass_hot: bool,
}

impl Temperatures {
    /// Takes new codes.
    pub fn update(&mut self, codes: TemperatureCodes) {
        self.fault = Fault::NONE;
        self.heat_sink_c = self.read(codes.heat_sink, Ntc::HeatSink).map(whole);
        self.glass = self.read(codes.glass, Ntc::Glass);
        self.coil_c = self.read(codes.coil, Ntc::Coil).map(whole);
        self.glass_hot = match self.glass.map(whole) {
            Some(c) if self.glass_hot => c >= GLASS_COOL_C,
            Some(c) => c >= GLASS_HOT_C,
            // A sensor that fails, or none, shows nothing that could be touched.
            None => true,
        };
        match self.heat_sink_c {
            Some(c) if c >= FAN_ON_C => self.fan = true,
            Some(c) if c >= FAN_OFF_C => {}
            // An unknown heat sink is cooled as soon as a sensor that should be there fails.
            _ => self.fan = self.fault != Fault::NONE,
        }
    }

    fn read(&mut self, code: Option<u16>, ntc: Ntc) -> Option<i32> {
        match ntc.sixteenths(code?) {
            Ok(sixteenths) => Some(sixteenths),
            Err(fault) => {
                self.fault = fault;
                None
            }
        }
    }

    /// [`Fault::NTC_OPEN`], [`Fault::NTC_SHORT`] or [`Fault::OVER_TEMPERATURE`], while it lasts.
    pub fn fault(&self) -> Fault {
        match self.fault {
            Fault::NONE if self.power_percent() == 0 => Fault::OVER_TEMPERATURE,
            fault => fault,
        }
    }

    /// Share of the rating that the hottest part leaves, in percent: all of it below the temperature
    /// where derating begins, none where it ends.
    pub fn power_percent(&self) -> u16 {
        let left = |celsius: Option<i16>, from_c: i16, off_c: i16| {
            let above = celsius.unwrap_or(from_c).clamp(from_c, off_c) - from_c;
            100 - (i32::from(above) * 100 / i32::from(off_c - from_c)) as u16
        };
        left(self.heat_sink_c, SINK_DERATE_C, SINK_OFF_C)
            .min(left(self.glass.map(whole), GLASS_DERATE_C, GLASS_OFF_C))
            .min(left(self.coil_c, COIL_DERATE_C, COIL_OFF_C))
    }

    /// Returns `true` while the fan runs.
    pub fn fan(&self) -> bool {
        self.fan
    }

    /// Returns `true` while the glass is hot enough to burn, or nothing is known of it.
    pub fn is_glass_hot(&self) -> bool {
        self.glass_hot
    }

    /// Heat sink, glass and coil, in °C.
    pub fn celsius(&self) -> [Option<i16>; 3] {
        [self.heat_sink_c, self.glass.map(whole), self.coil_c]
    }

    /// Glass in 1/16 °C; `None` without a sensor, or if it failed.
    pub fn glass(&self) -> Option<i32> {
        self.glass
    }
}

/// Index in the board's tables.
#[derive(Clone, Copy)]
enum Ntc {
    HeatSink,
    Glass,
    Coil,
}

impl Ntc {
    /// Temperature of a code in 1/16 °C, or what is wrong with the wire.
    fn sixteenths(self, code: u16) -> Result<i32, Fault> {
        let table = &CODES[self as usize];
        if code > table[0] {
            return Err(Fault::NTC_OPEN);
        }
        if code < NTC_SHORT_BELOW[self as usize] {
            return Err(Fault::NTC_SHORT);
        }
        // Codes fall with temperature.
        let above = table.partition_point(|&entry| entry >= code);
        let Some((&low, &high)) = table.get(above).zip(table.get(above.wrapping_sub(1))) else {
            return Ok(16 * i32::from(NTC_FROM_C + NTC_STEP_C * (ENTRIES as i16 - 1)));
        };
        let share =
            16 * i32::from(NTC_STEP_C) * i32::from(high - code) / i32::from((high - low).max(1));
        Ok(16 * i32::from(NTC_FROM_C + NTC_STEP_C * (above as i16 - 1)) + share)
    }
}

/// Whole degrees of 1/16 °C.
fn whole(sixteenths: i32) -> i16 {
    (sixteenths >> 4) as i16
}

#[cfg(test)]
mod tests {
    use ihd_shared::board;

    use super::*;

    fn code(ntc: Ntc, celsius: f64) -> u16 {
        let (ohm, b_k, pull_up_ohm) = match ntc {
            Ntc::HeatSink => (
                board::HEAT_SINK_NTC_OHM,
                board::HEAT_SINK_NTC_B_K,
                board::HEAT_SINK_PULL_UP_OHM,
            ),
            Ntc::Glass => (
                board::GLASS_NTC_OHM,
                board::GLASS_NTC_B_K,
                board::GLASS_PULL_UP_OHM,
            ),
            Ntc::Coil => (
                board::COIL_NTC_OHM,
                board::COIL_NTC_B_K,
                board::COIL_PULL_UP_OHM,
            ),
        };
        let colder = 1.0 / (celsius + 273.15) - 1.0 / 298.15;
        let ohm = f64::from(ohm) * (f64::from(b_k) * colder).exp();
        (4_096.0 * ohm / (ohm + f64::from(pull_up_ohm))).round() as u16
    }

    fn of_sink(celsius: f64) -> TemperatureCodes {
        TemperatureCodes {
            heat_sink: Some(code(Ntc::HeatSink, celsius)),
            ..TemperatureCodes::default()
        }
    }

    #[test]
    fn codes_become_degrees() {
        for celsius in (-20..=130).step_by(3) {
            let got = Ntc::HeatSink.sixteenths(code(Ntc::HeatSink, f64::from(celsius)));
            let error = f64::from(got.expect("in range")) / 16.0 - f64::from(celsius);
            assert!(error.abs() <= 1.5, "{celsius}: {error}");
        }
        for ntc in [Ntc::Glass, Ntc::Coil] {
            for celsius in (20..=300).step_by(7) {
                let got = ntc.sixteenths(code(ntc, f64::from(celsius)));
                let error = f64::from(got.expect("in range")) / 16.0 - f64::from(celsius);
                assert!(error.abs() <= 3.0, "{celsius}: {error}");
            }
        }
    }

    #[test]
    fn broken_and_shorted_wires_are_faults() {
        let with = |code| {
            let mut t = Temperatures::default();
            t.update(TemperatureCodes {
                glass: Some(code),
                ..TemperatureCodes::default()
            });
            t.fault()
        };
        assert_eq!(with(4_095), Fault::NTC_OPEN);
        assert_eq!(with(0), Fault::NTC_SHORT);
        assert_eq!(with(code(Ntc::Glass, 25.0)), Fault::NONE);
    }

    #[test]
    fn no_sensor_takes_nothing_away() {
        let mut t = Temperatures::default();
        t.update(TemperatureCodes::default());
        assert_eq!((t.power_percent(), t.fault()), (100, Fault::NONE));
    }

    #[test]
    fn power_falls_from_85_degrees_and_is_gone_at_105() {
        let percent = |celsius| {
            let mut t = Temperatures::default();
            t.update(of_sink(celsius));
            (t.power_percent(), t.fault())
        };
        assert_eq!(percent(80.0), (100, Fault::NONE));
        assert!((40..=60).contains(&percent(95.0).0));
        assert_eq!(percent(108.0), (0, Fault::OVER_TEMPERATURE));
    }

    #[test]
    fn hot_glass_is_shown_until_it_is_cool() {
        let mut t = Temperatures::default();
        let mut at = |glass| {
            t.update(TemperatureCodes {
                glass,
                ..TemperatureCodes::default()
            });
            t.is_glass_hot()
        };
        let mut at_c = |celsius| at(Some(code(Ntc::Glass, celsius)));
        let seen = [55.0, 62.0, 55.0, 48.0, 55.0].map(&mut at_c);
        assert_eq!(seen, [false, true, true, false, false]);
        // Open, short, not fitted: then it has to be found cool again.
        for broken in [Some(4_095), Some(0), None] {
            assert!(at(broken));
            assert!(at(Some(code(Ntc::Glass, 55.0))));
            assert!(!at(Some(code(Ntc::Glass, 45.0))));
        }
    }

    #[test]
    fn the_fan_has_hysteresis() {
        let mut t = Temperatures::default();
        let mut at = |celsius| {
            t.update(of_sink(celsius));
            t.fan()
        };
        assert!(!at(46.0));
        assert!(at(52.0));
        assert!(at(46.0));
        assert!(!at(39.0));
    }
}
