//! Table of all codes that accompany an estimate: severity, meaning, limit, advice. The tables of docs/identification.md are generated
//! from it, and a test searches the sources of all rooms for codes that are missing here.

/// One code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Code {
    /// Name in JSON.
    pub name: &'static str,
    /// Severities with which the code comes.
    pub severity: &'static str,
    /// Condition that the code reports.
    pub meaning: &'static str,
    /// Limit that the value is compared with.
    pub limit: &'static str,
    /// Action that the user can take.
    pub advice: &'static str,
}

const fn code(
    name: &'static str,
    severity: &'static str,
    meaning: &'static str,
    limit: &'static str,
    advice: &'static str,
) -> Code {
    Code {
        name,
        severity,
        meaning,
        limit,
        advice,
    }
}

/// A group of codes and its heading.
pub type Group = (&'static str, &'static [Code]);

/// Every code, grouped by the stage that raises it.
pub const CODES: &[Group] = &[
    ("Found in the capture (`ihd inspect`)", CAPTURE),
    ("Found about the sensors (self-calibration)", SENSORS),
    ("Found by the estimators", ESTIMATORS),
    ("Found by the gate", GATE),
];

const CAPTURE: &[Code] = &[
    code(
        "not_finite",
        "warning",
        "samples that are not finite; the capture is cut there",
        "none",
        "export again",
    ),
    code(
        "time_not_ascending",
        "error",
        "time does not ascend",
        "none",
        "export time with more digits, or as a rate",
    ),
    code(
        "gap",
        "warning",
        "samples are missing; the capture is cut there",
        "none",
        "record again",
    ),
    code(
        "piece_too_short",
        "warning",
        "a piece too short for an estimator was left out",
        "10 switching periods",
        "capture longer",
    ),
    code(
        "carrier_absent",
        "info",
        "no switching for a while; left out",
        "none",
        "nothing",
    ),
    code(
        "frequency_step",
        "info",
        "the switching frequency changes; each has a stretch of its own",
        "none",
        "nothing",
    ),
    code(
        "frequency_sweep",
        "info",
        "the switching frequency moves without steps; it is followed",
        "none",
        "nothing",
    ),
    code(
        "frequency_differs",
        "warning",
        "another switching frequency than was given",
        "the one given",
        "check --input fsw=HZ or the time base",
    ),
    code(
        "harmonic_taken",
        "error",
        "the frequency found is a harmonic of a lower line in the current",
        "a tenth of its amplitude",
        "--input fsw=HZ",
    ),
    code(
        "mains_differs",
        "warning",
        "another mains frequency than was given",
        "the one given",
        "check --input mains=HZ",
    ),
    code(
        "crossing_differs",
        "warning",
        "another mains zero crossing than was given",
        ".2 ms from the one given",
        "check --input zero-crossing=S",
    ),
    code(
        "mains_unknown",
        "warning",
        "no mains zero crossing found",
        "a half-cycle",
        "capture longer, or give --input mains=HZ,zero-crossing=S",
    ),
    code(
        "time_base",
        "warning; error below 45 and above 65 Hz",
        "the envelope is that of a mains that no grid has: the rate is wrong",
        "1.5 Hz from 50 or 60 Hz, and a third of what those leave of its variance",
        "give the rate: --input rate=HZ; or --input mains=HZ",
    ),
    code(
        "clipping",
        "warning, error",
        "samples of this stretch are at an end of the range; a warning where the other channel says what they were",
        "none at the range's end; 16 piled up where the range is unknown; restored to half of 1 % of R and .7 % of L",
        "use a larger range",
    ),
    code(
        "offset",
        "warning; info for phasor methods",
        "a channel has a mean",
        "see docs/captures.md",
        "zero the probe, or calibrate",
    ),
    code(
        "implausible",
        "warning",
        "a voltage or current above that of a hob's coil",
        "2 kV, 300 A",
        "check the probe's factor",
    ),
    code(
        "noisy",
        "info (a warning in `ihd inspect`)",
        "a low signal-to-noise ratio; `uncertain` has its cost",
        "see docs/captures.md",
        "use a smaller range, or more bits",
    ),
    code(
        "coarsely_sampled",
        "warning; info for phasor methods",
        "few samples a switching period",
        "12",
        "sample faster, or use a phasor method",
    ),
    code(
        "aliasing",
        "info, warning, error",
        "harmonics of the edges fall on the fundamental",
        "1 % of R for a warning, 3 % for an error",
        "shift the sampling rate, or f_sw, by some percent",
    ),
    code(
        "swapped",
        "warning: put right; error where that contradicts --input, and in `ihd inspect`",
        "voltage and current are exchanged",
        "none",
        "--input swap",
    ),
    code(
        "inverted",
        "warning: put right; error where that contradicts --input, and in `ihd inspect`",
        "one probe is reversed",
        "R and L above 0",
        "--input invert",
    ),
    code(
        "spikes",
        "warning",
        "single samples far out of those around them; the mean of their neighbours is taken",
        "a quarter of the rms value, 8 σ",
        "look at the cables",
    ),
    code(
        "phase_step",
        "warning",
        "samples are missing without a mark: both phases jump, the impedance does not; the capture is cut there",
        "3.5°, 12 times what is usual",
        "record again",
    ),
    code(
        "negative_resistance",
        "error",
        "R is negative, L is not: the channels are not simultaneous",
        "R above 0",
        "calibrate",
    ),
    code(
        "dead",
        "error",
        "a channel does not show the switching frequency",
        "none",
        "check the probe",
    ),
];

const SENSORS: &[Code] = &[
    code(
        "self_calibrated",
        "info",
        "skew, bandwidth or droop was corrected",
        "3 σ",
        "nothing; --self-calibrate off leaves it",
    ),
    code(
        "sensors_agree",
        "info",
        "no lag between the channels beyond its deviation",
        "3 σ",
        "nothing",
    ),
    code(
        "skew",
        "info, warning",
        "a skew of the channels that was not corrected",
        "3 σ; .5 % of R for a warning",
        "--self-calibrate auto, or ihd calibrate",
    ),
    code(
        "bandwidth",
        "info, warning",
        "a probe's bandwidth that was not corrected",
        "3 σ; .5 % of R for a warning",
        "--self-calibrate auto, or a faster probe",
    ),
    code(
        "droop",
        "info, warning",
        "a current probe's droop that was not corrected",
        "3 σ; .5 % of R for a warning",
        "--self-calibrate auto, or another probe",
    ),
    code(
        "sensor_nonlinear",
        "warning",
        "the current's gain changes with the current; put right where a saturation explains it",
        "0.4 % at the largest current",
        "a probe of more range",
    ),
    code(
        "plateaus_not_flat",
        "warning",
        "voltage and charge do not add up to a plateau between edges",
        "noise, 0.2 % of the capacitor's voltage",
        "look at both channels",
    ),
    code(
        "bridge_voltage",
        "error",
        "the voltage is the bridge's, not the coil's",
        "none",
        "connect the probe across the coil",
    ),
    code(
        "gain",
        "warning, error",
        "the ratio of the gains contradicts the capacitance given; the voltage is put right by up to 20 %",
        "1 %, 3 σ for a warning; 20 % for an error",
        "check the probes' factors",
    ),
    code(
        "gain_right",
        "info",
        "the ratio of the gains agrees with the capacitance given",
        "1 %, 3 σ",
        "nothing",
    ),
    code(
        "gain_unknown",
        "info, warning",
        "the capacitance that the capture shows if the gains are right; a warning where no hob has it",
        "150-5000 nF",
        "--input resonance-capacitance; check the probes' factors",
    ),
    code(
        "self_calibration_impossible",
        "info",
        "the capture does not show its sensors",
        "none",
        "nothing, or ihd calibrate",
    ),
];

const ESTIMATORS: &[Code] = &[
    code(
        "carrier_followed",
        "info",
        "the switching frequency moves within the stretch and was followed",
        "none",
        "nothing",
    ),
    code(
        "load_step",
        "info, warning",
        "the load steps inside a half-cycle: the pieces were identified, or the method passes over it",
        "6 % of the impedance, above noise and trend; less where two laws of the current fit and one does not",
        "nothing, or least-squares, lockin, pinn",
    ),
    code(
        "piece_left_out",
        "warning",
        "a piece between steps or zero crossings has no R and L",
        "10 switching periods",
        "nothing, or lockin",
    ),
    code(
        "model_residual",
        "info, warning",
        "R and L leave more of the voltage than noise explains; σ contains it",
        "χ² of 4; .5 % of R, .35 % of L for a warning",
        "look for a moving frequency, a step, a neighbouring coil, aliased edges",
    ),
    code(
        "noise_bias",
        "error",
        "noise of the current makes the linear filter's L too small by a predicted share",
        "see docs/identification.md",
        "another method",
    ),
    code(
        "contradicts_least_squares",
        "warning",
        "a filter differs from least squares; its σ contains the difference",
        "see docs/identification.md",
        "least-squares or pinn",
    ),
    code(
        "not_converged",
        "error; info if least squares agrees",
        "the network stopped before it converged",
        "none",
        "more steps, or the preset hybrid",
    ),
];

const GATE: &[Code] = &[
    code(
        "method_failed",
        "error",
        "the method gave no estimate",
        "none",
        "as its message says",
    ),
    code(
        "nothing_found",
        "error",
        "the estimate has no R and L",
        "none",
        "capture longer, or use another method",
    ),
    code(
        "not_covered",
        "warning; error for the lookup",
        "the estimate covers only a part of the half-cycles' middles",
        "90 %",
        "see the parts that were left out",
    ),
    code(
        "uncertain",
        "warning, error",
        "mean σ of R or L over the middle 80 % of a half-cycle: the reference's if the result agrees with it, else its own",
        ".7 % of R, .49 % of L for a warning; 3 % of either for an error",
        "a longer capture, a smaller range, more bits",
    ),
    code(
        "too_short",
        "warning, verdict: cannot tell",
        "no half-cycle of which half of the middle 80 % was captured, and σ of R or L over the stub is large or unknown. Beside \
         whole half-cycles a stub is left out, and its own verdict is this one",
        "3 % of either",
        "capture at least 10 ms",
    ),
    code(
        "disagreement",
        "warning; error for pinn, and for least squares with other settings: the σ of all others contains the difference",
        "mean difference from least squares of the same stretch, over the middle 80 % of a half-cycle",
        ".7 % of R, .49 % of L for a warning; 1 %, .7 % and twice what both σ explain for an error",
        "use least squares or pinn",
    ),
    code(
        "unconfirmed",
        "warning, error; info if an alias disturbs the lock-in alone",
        "mean difference between least squares and lock-in, both without foreign tones, beyond twice what both σ explain: \
         a change faster than they follow",
        ".7 % of R, .49 % of L for a warning; 1 %, .7 % for an error",
        "capture a steady load",
    ),
    code(
        "no_reference",
        "warning",
        "least squares failed on this stretch: nothing to check against",
        "none",
        "capture longer or sample faster",
    ),
    code(
        "correction_doubtful",
        "warning, error",
        "the correction of the sensors is uncertain",
        "6 MS/s (below, a lag under 4 % of the sampling interval is ignored); .35 % of R; half of 1 % with the bridge's resistance; 3 % for an error",
        "sample faster, --self-calibrate off, or ihd calibrate",
    ),
    code(
        "interference",
        "info, warning, error",
        "a tone beside f_sw that is neither harmonic nor sideband of the mains, with its measured cost for least squares; that of \
         another hob is removed by `ihd identify`, and then no error",
        ".2 % of R, .14 % of L to be mentioned; .7 %, .49 % for a warning; 1 %, .7 % for an error",
        "switch the neighbouring coil off; another rate if it is an alias",
    ),
    code(
        "load_moves",
        "warning",
        "R and L are not functions of the current's amplitude alone, and no tone explains it: a drift, a step, a neighbour whose \
         tone turns less than once in the stretch",
        "misfit of .35 % of R, .25 % of L, and 5 σ of the noise",
        "leave the pot alone; capture longer; switch the neighbouring coil off",
    ),
    code(
        "implausible_load",
        "warning; error ten times beyond, and for the lookup",
        "R or L outside those of hobs",
        "0.02-15.9 Ω, 2-63.9 µH",
        "check the probes' factors",
    ),
];

/// Finds a code by its name.
pub fn find(name: &str) -> Option<&'static Code> {
    CODES
        .iter()
        .flat_map(|(_, codes)| codes.iter())
        .find(|code| code.name == name)
}

/// Renders the tables of docs/identification.md.
pub fn markdown() -> String {
    let mut text = String::new();
    for (heading, codes) in CODES {
        text += &format!(
            "\n### {heading}\n\n| code | severity | what | limit | what to do |\n|---|---|---|---|---|\n"
        );
        for c in *codes {
            text += &format!(
                "| `{}` | {} | {} | {} | {} |\n",
                c.name, c.severity, c.meaning, c.limit, c.advice
            );
        }
    }
    text
}
