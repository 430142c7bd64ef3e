//! Checks of bridge, sensors and load by a window of samples.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use ihd_link::Window;
use ihd_shared::hob::{LINK_CAPACITANCE_NF, RESONANCE_CAPACITANCE_NF, TANK_CAPACITANCE_PF};
use ihd_shared::wire::messages::FrontEnd;
use ihd_signal::{Capture, TimeBase};
use ihd_survey::calibration::{ReferenceLoad, estimate};
use ihd_survey::{Hints, Survey};

use super::period::Period;
use super::{SwitchingRecord, code_v};
use crate::board::OFFSET_CODES;
use crate::{Check, Measurement};

/// Dead time set by the firmware, in nanoseconds (`firmware/src/drive/pwm.rs`): both switches are open for that long.
const DEAD_TIME_NS: f64 = 1_000.0;

/// Range of the fraction of a period for which the bridge's node is high: half, within the resolution of the samples.
const HIGH: (f64, f64) = (0.48, 0.52);

/// Range of the edge's height over the bus voltage: two dividers, and the capacitor's ripple.
const COIL_OVER_BUS: (f64, f64) = (0.9, 1.1);

/// Ranges of a load in ohm and microhenry: those of a lookup's cells.
const R_OHM: (f64, f64) = (0.02, 15.9);
const L_UH: (f64, f64) = (2.0, 63.9);

/// Range of the current's lag behind the voltage, in degrees: outside, a sensor is reversed or the tank is below resonance.
const LAG_DEG: (f64, f64) = (5.0, 89.9);

/// Lowest resonance of the tank in kilohertz, and the required ratio of the switching frequency to it.
const MIN_RESONANCE_KHZ: f64 = 19.0;
const ABOVE_RESONANCE: f64 = 1.06;

/// Limit of the skew between the channels, in nanoseconds: RC of 3 % at most, 9 ns (docs/board.md), and the converters' triggers.
const SKEW_NS: f64 = 20.0;

/// Range of the ratio of the channels' gains: 1 % of T1 and dividers of 0.1 %, and the reference's own error.
const GAIN: (f64, f64) = (0.97, 1.03);

/// Checks that the bridge switched, and the reason why it ended.
pub(super) fn switching(seen: &SwitchingRecord) -> Check {
    const NAME: &str = "switching";
    let finding = format!(
        "windows of samples: {}; bus {:.1} V, current up to {:.2} A",
        seen.windows.len(),
        seen.bus_v,
        seen.i_a
    );
    match (&seen.ended_by, seen.windows.is_empty()) {
        (Some(why), _) if why == "^C" => Check::not_tested(NAME, format!("ended by ^C; {finding}")),
        (Some(why), _) => Check::fail(
            NAME,
            format!("ended early: {why}; {finding}"),
            "Look at the load (a short, a pan of aluminium), the supply, and the table of faults in docs/bring-up.md",
        ),
        (None, true) => Check::not_tested(
            NAME,
            format!("it looked for a pot and judged none; {finding}"),
        )
        .with_remedy("Below 1.5 A a pot is not judged: a ferromagnetic pot, and 40 V or more"),
        (None, false) => Check::pass(NAME, finding),
    }
}

/// Makes all other checks, from one window.
pub(super) fn window(
    window: &Window,
    scales: &FrontEnd,
    bus_v: f64,
    reference: Option<ReferenceLoad>,
) -> Vec<Check> {
    let Some(period) = Period::from_window(window) else {
        let names = super::NAMES.into_iter().skip(3);
        return names
            .map(|name| Check::not_tested(name, "the window is too short"))
            .collect();
    };
    let mut checks = edges(&period, bus_v);
    checks.push(offsets(&period, scales));
    checks.extend(load(&period, window.f_sw_hz));
    checks.push(skew(window, scales, reference));
    checks
}

/// Checks duration, duty and height of the node's edges.
fn edges(period: &Period, bus_v: f64) -> Vec<Check> {
    let Some([rise, fall]) = period.edges() else {
        let why = "no edge stands out of the samples";
        return vec![
            Check::not_tested("edges", why),
            Check::not_tested("coil_against_bus", why),
        ];
    };
    let resolution_ns = period.resolution_s() * 1e9;
    let (rise_ns, fall_ns) = (rise.own_s * 1e9, fall.own_s * 1e9);
    let high = (fall.at - rise.at).rem_euclid(1.0);
    let most_ns = DEAD_TIME_NS + resolution_ns;
    let edges = Check::measured(
        "edges",
        format!(
            "the node turns over in {rise_ns:.0} and {fall_ns:.0} ns (seen to {resolution_ns:.0} ns) of {DEAD_TIME_NS:.0} ns \
             of dead time, and is high for {:.1} % of a period",
            100.0 * high
        ),
        vec![
            Measurement::between("rise", rise_ns, "ns", 0.0, most_ns),
            Measurement::between("fall", fall_ns, "ns", 0.0, most_ns),
            Measurement::between("high", high, "of a period", HIGH.0, HIGH.1),
            Measurement::informative("resolution", resolution_ns, "ns"),
        ],
        "Too slow: too little current for the node's capacitance, which a switch then closes onto. Not half: one gate is \
         late. The dead time itself is seen at the gates alone (docs/bring-up.md, B5 and E5)",
    );
    let step_v = 0.5 * (rise.step_v - fall.step_v);
    let ratio = step_v / bus_v;
    let against = match bus_v > 1.0 {
        true => Check::measured(
            "coil_against_bus",
            format!("the coil's voltage steps by {step_v:.1} V, the bus has {bus_v:.1} V"),
            vec![Measurement::between(
                "ratio",
                ratio,
                "",
                COIL_OVER_BUS.0,
                COIL_OVER_BUS.1,
            )],
            "One of the two dividers, at PA0 or PB1, has another gain (docs/board.md); measure D2 and D5",
        ),
        false => Check::not_tested("coil_against_bus", "the device reported no bus voltage"),
    };
    vec![edges, against]
}

/// Checks the means while it switches: the capacitor blocks direct current.
fn offsets(period: &Period, scales: &FrontEnd) -> Check {
    let (v_v, i_a) = period.means();
    let (volt, ampere) = code_v(scales);
    let (v, i) = (v_v / volt, i_a / ampere);
    Check::measured(
        "offsets",
        format!("{v_v:+.2} V and {i_a:+.3} A over whole periods"),
        vec![
            Measurement::between("coil voltage", v, "codes", -OFFSET_CODES, OFFSET_CODES),
            Measurement::between("coil current", i, "codes", -OFFSET_CODES, OFFSET_CODES),
        ],
        "The amplifiers' reference, or common mode that an amplifier does not reject: compare with `channels` of the bridge off",
    )
}

/// Checks R and L of the fundamental, and the resonance that follows.
fn load(period: &Period, f_sw_hz: u32) -> Vec<Check> {
    let Some(z) = period.impedance() else {
        let why = "there is no current to speak of";
        return vec![
            Check::not_tested("load", why).with_remedy("Coil, capacitor, T1's plug"),
            Check::not_tested("resonance", why),
        ];
    };
    let f_khz = f64::from(f_sw_hz) * 1e-3;
    let lag_deg = (TAU * f64::from(f_sw_hz) * z.l_h)
        .atan2(z.r_ohm)
        .to_degrees();
    let l_uh = z.l_h * 1e6;
    let load = Check::measured(
        "load",
        format!(
            "R {:.2} Ω, L {l_uh:.1} µH at {f_khz:.1} kHz and {:.2} A",
            z.r_ohm, z.i_a
        ),
        vec![
            Measurement::between("R", z.r_ohm, "Ω", R_OHM.0, R_OHM.1),
            Measurement::between("L", l_uh, "µH", L_UH.0, L_UH.1),
            Measurement::between("lag", lag_deg, "°", LAG_DEG.0, LAG_DEG.1),
            Measurement::informative("current", z.i_a, "A"),
        ],
        "Negative: polarity of SW − X or of T1. Else gains (docs/bring-up.md, D), or another coil",
    );
    let c_f = f64::from(TANK_CAPACITANCE_PF) * 1e-12;
    let resonance_khz = 1e-3 / (TAU * (z.l_h * c_f).sqrt());
    let most_khz = f_khz / ABOVE_RESONANCE;
    let resonance = Check::measured(
        "resonance",
        format!("{resonance_khz:.1} kHz with C_r and C2, switched at {f_khz:.1} kHz"),
        vec![Measurement::between(
            "resonance",
            resonance_khz,
            "kHz",
            MIN_RESONANCE_KHZ,
            most_khz,
        )],
        format!(
            "C_r is {RESONANCE_CAPACITANCE_NF} nF, C2 {LINK_CAPACITANCE_NF} nF in the board's file: measure them"
        ),
    );
    vec![load, resonance]
}

/// Checks the skew of the current against the voltage, if the load is known.
fn skew(window: &Window, scales: &FrontEnd, reference: Option<ReferenceLoad>) -> Check {
    const NAME: &str = "skew";
    let Some(reference) = reference else {
        return Check::not_tested(NAME, "skew and load look alike where nothing is known of the load").with_remedy(
            "--reference r=OHM,l=HENRY with a load that was measured; for the calibration: ihd calibrate (docs/bring-up.md)",
        );
    };
    let capture = capture(window, scales);
    let skew = Survey::from_capture(&capture, &Hints::default())
        .map_err(|e| e.to_string())
        .and_then(|survey| estimate(&capture, &survey, reference).map_err(|e| e.to_string()));
    let skew = match skew {
        Ok(skew) => skew,
        Err(why) => return Check::not_tested(NAME, why),
    };
    let doubts = skew.doubts();
    let (skew_ns, sigma_ns) = (skew.skew_s * 1e9, skew.skew_sigma_s * 1e9);
    let check = Check::measured(
        NAME,
        format!(
            "{skew_ns:+.1} ± {sigma_ns:.1} ns, gain ratio {:.4} ± {:.4}, against {}",
            skew.gain_ratio, skew.gain_ratio_sigma, skew.reference
        ),
        vec![
            Measurement::between("skew", skew_ns, "ns", -SKEW_NS, SKEW_NS),
            Measurement::informative("sigma", sigma_ns, "ns"),
            Measurement::between("gain ratio", skew.gain_ratio, "", GAIN.0, GAIN.1),
        ],
        "The RC of PA0 and PA1 (316 Ω, 1 nF) differ, or the reference is not this load. ihd calibrate takes a skew out",
    );
    match doubts.is_empty() {
        true => check,
        false => check.with_remedy(doubts.join("; ")),
    }
}

/// Converts a window to a capture.
fn capture(window: &Window, scales: &FrontEnd) -> Capture {
    let scales = scales.scales();
    let segment = window.segment();
    Capture {
        name: format!("window {}", window.seq),
        time: TimeBase::Even {
            t0_s: segment.t0_s,
            dt_s: segment.dt_s,
        },
        v_v: segment.v_v.iter().map(|v| *v as f32).collect(),
        i_a: segment.i_a.iter().map(|i| *i as f32).collect(),
        v_full_scale_v: Some(scales.v_full_scale_v()),
        i_full_scale_a: Some(scales.i_full_scale_a()),
        f_sw: vec![ihd_signal::capture::FrequencyStep {
            t_s: segment.t0_s,
            f_sw_hz: segment.f_sw_hz,
        }],
        mains_hz: Some(segment.mains_hz),
        zero_crossing_s: Some(0.0),
        truth: Vec::new(),
        metadata: BTreeMap::new(),
    }
}
