//! Texts of findings: numbers, their effect on R and L, and advice.

use std::fmt;

use super::Finding;
use crate::grid;

/// Reason for which an envelope of so many half-cycles shows no mains, with advice.
fn no_mains(half_cycles: f64, modulation: f64) -> String {
    let pct = modulation * 100.0;
    if half_cycles < 1.0 {
        return format!(
            "{half_cycles:.2} half-cycles with {pct:.0} % modulation show no mains zero crossing: capture one half-cycle at least"
        );
    }
    if modulation < grid::MIN_MODULATION {
        return format!(
            "the voltage's amplitude shows no mains ({pct:.0} % modulation): capture with a rectified mains"
        );
    }
    let (from_hz, to_hz) = grid::RANGE_HZ;
    format!(
        "the voltage's amplitude follows no mains of {from_hz} to {to_hz} Hz: capture at constant power and load"
    )
}

impl fmt::Display for Finding {
    #[expect(clippy::too_many_lines, reason = "one message a kind")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { samples, first } => write!(
                f,
                "{samples} samples are no numbers, the first at index {first}: the capture is cut there"
            ),
            Self::TimeNotAscending { times, sample, t_s } => write!(
                f,
                "time does not ascend at sample {sample} ({t_s:.9} s) and {} more: the capture is \
                 cut there; export the time column with more digits, or as a rate",
                times - 1
            ),
            Self::Gap {
                gaps,
                t_s,
                longest_s,
                missing,
            } => write!(
                f,
                "{gaps} gaps, {missing} samples missing, the first at {t_s:.6} s, the longest of \
                 {:.3} ms: the capture is cut there",
                longest_s * 1e3
            ),
            Self::PieceTooShort { pieces, total_s } => write!(
                f,
                "{pieces} pieces, {:.3} ms in all, are too short to be worked on and left out",
                total_s * 1e3
            ),
            Self::CarrierAbsent { from_s, to_s } => write!(
                f,
                "no switching from {:.3} to {:.3} ms: left out",
                from_s * 1e3,
                to_s * 1e3
            ),
            Self::FrequencyStep {
                t_s,
                from_hz,
                to_hz,
            } => write!(
                f,
                "the switching frequency changes at {:.3} ms from {:.2} to {:.2} kHz",
                t_s * 1e3,
                from_hz * 1e-3,
                to_hz * 1e-3
            ),
            Self::FrequencySweep {
                mean_hz,
                deviation_hz,
                rate_hz,
            } => write!(
                f,
                "the switching frequency moves by {:.2} kHz around {:.2} kHz, like a sine of {rate_hz:.0} Hz: least \
                 squares, lock-in and pinn follow it",
                deviation_hz * 1e-3,
                mean_hz * 1e-3
            ),
            Self::FrequencyDiffers {
                specified_hz,
                measured_hz,
            } => write!(
                f,
                "a switching frequency of {:.2} kHz is specified, but {:.2} kHz is measured and used: check the \
                 frequency given, or the time base",
                specified_hz * 1e-3,
                measured_hz * 1e-3
            ),
            Self::HarmonicTaken {
                f_hz,
                order,
                share_pct,
            } => write!(
                f,
                "{:.2} kHz is harmonic {order} of {:.2} kHz, which the current has with {share_pct:.0} % of its amplitude: if the \
                 bridge switches there, give --input fsw={:.2}k",
                f_hz * 1e-3,
                f_hz * 1e-3 / f64::from(*order),
                f_hz * 1e-3 / f64::from(*order)
            ),
            Self::MainsDiffers {
                specified_hz,
                measured_hz,
            } => write!(
                f,
                "a mains frequency of {specified_hz:.2} Hz is specified and used, but the envelope shows \
                 {measured_hz:.2} Hz"
            ),
            Self::CrossingDiffers {
                specified_s,
                measured_s,
            } => write!(
                f,
                "a mains zero crossing at {:.3} ms is specified and used, but the envelope shows it at {:.3} ms: check --input zero-crossing=S",
                specified_s * 1e3,
                measured_s * 1e3
            ),
            Self::MainsUnknown {
                assumed_hz,
                hz_source,
                half_cycles,
                modulation,
            } => write!(
                f,
                "{}, or give --input zero-crossing=S; {assumed_hz:.2} Hz is {hz_source}",
                no_mains(*half_cycles, *modulation)
            ),
            Self::TimeBase { shown_hz, rate_hz } => write!(
                f,
                "the envelope is that of a mains of {shown_hz:.2} Hz, which no grid has: the time base is wrong by {:+.1} or {:+.1} %, and \
                 L and the frequencies with it; give --input rate={:.4}M for 50 Hz, {:.4}M for 60 Hz, or mains={shown_hz:.1} if it is right",
                2.0 * shown_hz - 100.0,
                shown_hz / 0.6 - 100.0,
                rate_hz * 50e-6 / shown_hz,
                rate_hz * 60e-6 / shown_hz
            ),
            Self::Clipping {
                channel,
                samples,
                rails,
                ..
            } => write!(
                f,
                "the {channel} is clipped at {}: {samples} samples; R and L are wrong there: use a larger range",
                rails.in_words(channel.unit())
            ),
            Self::Offset {
                channel,
                mean,
                of_rms_pct,
            } => write!(
                f,
                "the {channel} has an offset of {mean:.3} {} ({of_rms_pct:.1} % of its rms): \
                 lock-in, least squares and pinn take it off, filters in the time domain lose accuracy; zero the \
                 probe or calibrate",
                channel.unit()
            ),
            Self::Noisy { channel, snr_db } => write!(
                f,
                "the {channel} has a signal-to-noise ratio of {snr_db:.0} dB only: use a smaller \
                 range or more bits"
            ),
            Self::CoarselySampled { samples_per_period } => write!(
                f,
                "{samples_per_period:.1} samples a switching period: filters in the time domain \
                 need 20 and more; phasor methods work"
            ),
            Self::Aliasing {
                samples_per_period,
                order,
                r_pct,
                l_pct,
            } => write!(
                f,
                "{samples_per_period:.4} samples a switching period let harmonic {order} of the \
                 voltage's edges fall on the fundamental: about {r_pct:.1} % of R and {l_pct:.1} % \
                 of L without an anti-alias filter; shift the sampling rate, or the switching frequency, by some percent"
            ),
            Self::Swapped { by_user } => write!(
                f,
                "voltage and current are exchanged (the impedance falls with frequency): {} --input swap",
                if *by_user { "leave out" } else { "use" }
            ),
            Self::Inverted { r_ohm, by_user } => write!(
                f,
                "R is {r_ohm:.3} ohm and L negative too: one probe is the wrong way round; {}",
                if *by_user {
                    "leave out --input invert"
                } else {
                    "use --input invert=i"
                }
            ),
            Self::Implausible {
                channel,
                peak,
                most,
            } => write!(
                f,
                "the {channel} reaches {peak:.0} {unit}; that of a hob stays below {most:.0} {unit}: check the \
                 probe's factor (--input probe) and the unit (--input units)",
                unit = channel.unit()
            ),
            Self::NegativeResistance { r_ohm, skew_s } => write!(
                f,
                "R is {r_ohm:.3} ohm but L positive: the current is sampled at least {:.0} ns \
                 {} than the voltage; calibrate (ihd calibrate)",
                skew_s.abs() * 1e9,
                if *skew_s < 0.0 { "earlier" } else { "later" }
            ),
            Self::Dead { channel } => write!(
                f,
                "the {channel} does not show the switching frequency: is its probe connected, and \
                 the right column chosen?"
            ),
        }
    }
}
