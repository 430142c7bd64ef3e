//! Checks of clocks, channels, supply, comparators and temperatures against limits.

use ihd_link::Client;
use ihd_shared::sampling::CODE_HALF_RANGE;
use ihd_shared::wire::messages::{Channels, Clocks, Comparators, FrontEnd, NO_SENSOR_C, Status};

use crate::check_session::CheckSession;
use crate::{Check, Measurement};

/// Factor by which a message scales codes.
const CODE_SCALE: f64 = 256.0;

/// Limit of the offset by docs/bring-up.md D1: 10 mV at the pin, in codes of 0.8 mV.
pub(crate) const OFFSET_CODES: f64 = 12.0;

/// Limit of a channel's noise in codes rms. The converter's own noise is 0.9 (SNR of 64 dB, DS12288). 4 codes are 0.16 A; after
/// averaging over the demodulator's 0.2 ms this is 1 % of 1.5 A, the smallest current judged.
const NOISE_CODES: f64 = 4.0;

/// Lower limit of the noise in codes rms: below it the channel does not convert.
const MIN_NOISE_CODES: f64 = 0.05;

/// Nominal frequency of the low-speed oscillator in hertz, and the limit in percent for the main clock's count in its periods
/// (docs/board.md: both oscillators over temperature and supply, with some margin).
const LSI_HZ: f64 = 32_000.0;
const LSI_PCT: (f64, f64) = (-8.0, 9.8);

/// Tolerance of HSI16 from 0 to 85 °C in percent, against the crystal of a USB host.
const HSI_PCT: f64 = 1.0;

/// Tolerance of the clock by USB full speed: 0.25 % of 48 000 periods in a frame.
const HSI48_PERIODS: f64 = 120.0;

/// Range of the analogue supply in millivolt: 3.3 V of a NUCLEO ± 5 %. All scales are ratios to it.
const VDDA_MV: (f64, f64) = (3_135.0, 3_465.0);

/// Range of a cold board's temperatures in degrees Celsius.
const TEMPERATURE_C: (f64, f64) = (-20.0, 85.0);

/// Examines clocks, measuring channels, comparators and temperatures.
pub(super) fn examine(session: &mut CheckSession<'_>, scales: &FrontEnd) {
    if let Some(found) = session.check_answer("clocks", Client::clocks) {
        session.add(clocks(&found));
    }
    match session.check_answer("channels", Client::channels) {
        Some(found) => {
            session.add(offsets(&found, scales));
            session.add(noise(&found));
            session.add(supply(&found));
        }
        None => {
            for name in ["noise", "supply"] {
                session.add(Check::not_tested(name, "the channels were not measured"));
            }
        }
    }
    if let Some(found) = session.check_answer("comparators", Client::comparators) {
        session.add(comparators(&found));
    }
    // Asked now: right after its start the device has read no sensor.
    if let Some(status) = session.check_answer("temperatures", Client::status) {
        session.add(temperatures(&status));
    }
}

/// Compares the clocks with each other.
fn clocks(c: &Clocks) -> Check {
    const NAME: &str = "clocks";
    let remedy = "Another controller: one of the oscillators is off (docs/board.md)";
    if c.main_hz == 0 || c.lsi_periods == 0 {
        return Check::fail(NAME, "the low-speed oscillator stands still", remedy);
    }
    let main_hz = f64::from(c.main_hz);
    let off_pct =
        |cycles: u32, seconds: f64| 100.0 * (f64::from(cycles) / (main_hz * seconds) - 1.0);
    let periods = f64::from(c.lsi_periods);
    let lsi_khz = periods * main_hz / f64::from(c.lsi_main_cycles.max(1)) * 1e-3;
    let by_lsi = off_pct(c.lsi_main_cycles, periods / LSI_HZ);
    let mut evidence = vec![
        Measurement::between("main clock by LSI", by_lsi, "%", LSI_PCT.0, LSI_PCT.1),
        Measurement::informative("LSI", lsi_khz, "kHz"),
    ];
    if c.usb_frames > 0 {
        let by_usb = off_pct(c.usb_main_cycles, f64::from(c.usb_frames) * 1e-3);
        let off = f64::from(c.hsi48_off);
        evidence.extend([
            Measurement::between("main clock by USB", by_usb, "%", -HSI_PCT, HSI_PCT),
            Measurement::between(
                "HSI48 in a frame",
                off,
                "periods",
                -HSI48_PERIODS,
                HSI48_PERIODS,
            ),
            Measurement::informative("HSI48 trim", c.hsi48_trim.into(), ""),
        ]);
    }
    let finding = format!(
        "{:.0} MHz; by LSI {by_lsi:+.1} %{}",
        main_hz * 1e-6,
        match c.usb_frames {
            0 => "; no USB host to compare with a crystal",
            _ => ", and by the USB host's crystal",
        }
    );
    Check::measured(NAME, finding, evidence, remedy)
}

/// Checks the means of the channels without current and voltage.
fn offsets(c: &Channels, scales: &FrontEnd) -> Check {
    const NAME: &str = "channels";
    if c.samples == 0 {
        return Check::fail(
            NAME,
            "the converters delivered nothing",
            "ihd log; press NRST",
        );
    }
    let (v, i) = (
        f64::from(c.v_mean) / CODE_SCALE,
        f64::from(c.i_mean) / CODE_SCALE,
    );
    let code_mv = |full_scale: u32| f64::from(full_scale) / f64::from(CODE_HALF_RANGE) / 1e3;
    let bus_v = bus_volt(c, scales);
    let mains_v = f64::from(c.mains_rms) / CODE_SCALE * code_mv(scales.mains_full_scale_mv);
    let evidence = vec![
        Measurement::between("coil voltage", v, "codes", -OFFSET_CODES, OFFSET_CODES),
        Measurement::between("coil current", i, "codes", -OFFSET_CODES, OFFSET_CODES),
        Measurement::informative("bus", bus_v, "V"),
        Measurement::informative("mains", mains_v, "V rms"),
        Measurement::informative("pairs", c.samples.into(), ""),
    ];
    let finding = format!(
        "offsets {v:+.1} codes ({:+.2} V) and {i:+.1} codes ({:+.3} A); bus {bus_v:.1} V, mains {mains_v:.0} V",
        v * code_mv(scales.v_full_scale_mv),
        i * code_mv(scales.i_full_scale_ma)
    );
    Check::measured(
        NAME,
        finding,
        evidence,
        "PA0, PA1 belong at 1.650 V (VDDA/2) within 10 mV: measure them, then the amplifiers' reference (docs/board.md)",
    )
}

/// Bus voltage in volt.
pub(crate) fn bus_volt(c: &Channels, scales: &FrontEnd) -> f64 {
    let codes = 2.0 * f64::from(CODE_HALF_RANGE);
    f64::from(c.bus_mean) / CODE_SCALE / codes * f64::from(scales.bus_full_scale_mv) / 1e3
}

/// Checks the noise of the fast channels.
fn noise(c: &Channels) -> Check {
    let of = |name, rms: u32| {
        let codes = f64::from(rms) / CODE_SCALE;
        Measurement::between(name, codes, "codes rms", MIN_NOISE_CODES, NOISE_CODES)
    };
    let evidence = vec![of("coil voltage", c.v_rms), of("coil current", c.i_rms)];
    let texts: Vec<_> = evidence.iter().map(Measurement::text).collect();
    Check::measured(
        "noise",
        texts.join("; "),
        evidence,
        "Too much: ground of the front end, the anti-alias RC at PA0 and PA1, a switching supply nearby. None at all: \
         the converter or its trigger stands still",
    )
}

/// Checks the analogue supply by the chip's own reference.
fn supply(c: &Channels) -> Check {
    const NAME: &str = "supply";
    if c.vdda_mv == 0 || c.reference == 0 {
        return Check::not_tested(NAME, "the device did not measure its reference");
    }
    let vdda = f64::from(c.vdda_mv);
    let evidence = vec![
        Measurement::between("VDDA", vdda, "mV", VDDA_MV.0, VDDA_MV.1),
        Measurement::informative("reference", c.reference.into(), "codes"),
    ];
    Check::measured(
        NAME,
        format!("VDDA {:.3} V by the chip's reference", vdda / 1e3),
        evidence,
        "Measure 3V3; every scale and the trip level move with it",
    )
}

/// Checks the trip in hardware.
fn comparators(c: &Comparators) -> Check {
    const NAME: &str = "comparators";
    let seen = [
        (
            c.positive_tripped,
            "COMP1 (PA1, positive current) did not reach its fault input",
        ),
        (
            c.positive_quiet,
            "COMP1 (PA1, positive current) stays tripped",
        ),
        (
            c.negative_tripped,
            "COMP2 (PA7, negative current) did not reach its fault input",
        ),
        (
            c.negative_quiet,
            "COMP2 (PA7, negative current) stays tripped",
        ),
    ];
    let bad: Vec<_> = seen
        .iter()
        .filter(|(good, _)| !good)
        .map(|(_, text)| *text)
        .collect();
    match bad.is_empty() {
        true => Check::pass(
            NAME,
            "both tripped through their DAC, reached the fault inputs, and are quiet again",
        ),
        false => Check::fail(
            NAME,
            bad.join("; "),
            "Nothing would stop an over-current: do not put voltage on the bus. Stays tripped: PA1, PA7 belong at 1.650 V",
        ),
    }
}

/// Checks the temperatures of heat sink, glass and coil.
fn temperatures(status: &Status) -> Check {
    const NAME: &str = "temperatures";
    let all = [
        ("heat sink", status.heat_sink_c),
        ("glass", status.glass_c),
        ("coil", status.coil_c),
    ];
    let there = all.iter().filter(|(_, c)| *c != NO_SENSOR_C);
    let evidence: Vec<_> = there
        .map(|(name, c)| {
            Measurement::between(name, f64::from(*c), "°C", TEMPERATURE_C.0, TEMPERATURE_C.1)
        })
        .collect();
    let missing: Vec<_> = all
        .iter()
        .filter(|(_, c)| *c == NO_SENSOR_C)
        .map(|(name, _)| *name)
        .collect();
    if evidence.is_empty() {
        return Check::not_tested(
            NAME,
            "no sensor is fitted: nothing but you watches the heat sink",
        );
    }
    let mut finding: Vec<_> = evidence.iter().map(Measurement::text).collect();
    if !missing.is_empty() {
        finding.push(format!("no sensor: {}", missing.join(", ")));
    }
    Check::measured(
        NAME,
        finding.join("; "),
        evidence,
        "Let it cool down; else the NTC or its wiring (docs/board.md)",
    )
}
