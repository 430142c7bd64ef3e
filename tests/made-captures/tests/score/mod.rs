//! Comparison of verdicts and causes with the truth.

use std::fmt;

use ihd_gate::{Examination, ExamineOptions, MethodResult, Reconstruct, Verdict, examine};
use ihd_identify::trajectory::TrajectoryCursor;
use ihd_identify::{IdentifyOptions, Method};
use ihd_made_captures::{Kind, MadeCapture, Times, make};
use ihd_signal::{Capture, Remark, Severity, TimeBase};
use ihd_survey::Hints;
use ihd_survey::calibration::blind::{BlindOptions, CalibrationMode};

/// Methods that are counted; the first one is that of the tables by kind.
pub const METHODS: [Method; 2] = [Method::LeastSquares, Method::Lockin];

/// Mean error of R and of L in percent above which a half-cycle is wrong.
const WRONG_PCT: [f64; 2] = [1.0, 0.7];

/// Fewest periods of a half-cycle's middle that are compared.
const MIN_PERIODS: usize = 20;

/// Codes that name a cause.
const CAUSES: [&str; 18] = [
    "time_base",
    "phase_step",
    "interference",
    "skew",
    "bandwidth",
    "droop",
    "self_calibrated",
    "sensor_nonlinear",
    "gain",
    "clipping",
    "swapped",
    "inverted",
    "dead",
    "bridge_voltage",
    "load_step",
    "gap",
    "not_finite",
    "negative_resistance",
];

/// Codes that name the cause of a kind.
fn accepted(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::NeighbourMultiple
        | Kind::NeighbourOdd
        | Kind::NeighbourHeld
        | Kind::NeighbourFar
        | Kind::NeighbourTwo
        | Kind::NeighbourNear => &["interference"],
        Kind::Skew => &["skew", "self_calibrated"],
        Kind::Droop => &["droop", "self_calibrated"],
        Kind::SlowProbe => &[
            "bandwidth",
            "skew",
            "self_calibrated",
            "negative_resistance",
        ],
        Kind::Gain => &["gain"],
        Kind::ClippedCurrent | Kind::ClippedVoltage => &["clipping"],
        Kind::Saturation => &["sensor_nonlinear"],
        Kind::Lost => &["phase_step", "gap"],
        Kind::LostStamped => &["gap"],
        Kind::WrongRate => &["time_base", "mains_unknown", "mains_differs"],
        Kind::TooShort => &["too_short", "mains_unknown", "piece_too_short"],
        Kind::Jitter | Kind::Coloured | Kind::Noise10Db | Kind::Coarse => {
            &["noisy", "uncertain", "model_residual"]
        }
        Kind::Spikes => &["spikes", "noisy", "uncertain", "model_residual"],
        Kind::LoadStep => &["load_step"],
        Kind::Drift => &["load_moves"],
        Kind::Swapped => &["swapped"],
        Kind::Inverted => &["inverted"],
        Kind::FrequencyStep => &["frequency_step"],
        _ => &[],
    }
}

/// Result of one method on one capture.
#[derive(Clone, Debug)]
pub struct Row {
    pub kind: Kind,
    pub seed: u64,
    pub method: Method,
    /// Worst errors in percent over the half-cycles that pass, and over the others.
    pub passed_pct: Option<[f64; 2]>,
    pub refused_pct: Option<[f64; 2]>,
    /// `true` if a right half-cycle was refused.
    pub refused_right: bool,
    /// Findings with their severities.
    pub findings: Vec<(Severity, &'static str)>,
    pub error: Option<String>,
}

impl Row {
    fn is_wrong(pct: &Option<[f64; 2]>) -> bool {
        pct.is_some_and(|pct| !(pct[0] <= WRONG_PCT[0] && pct[1] <= WRONG_PCT[1]))
    }

    /// Codes that a user sees as a warning or an error.
    fn doubts(&self) -> impl Iterator<Item = &'static str> {
        let seen = self.findings.iter().filter(|f| f.0 >= Severity::Warning);
        seen.map(|f| f.1)
    }

    pub fn is_silent(&self) -> bool {
        Self::is_wrong(&self.passed_pct) && self.doubts().next().is_none()
    }

    /// Wrong and said: refused, or passed with a warning.
    pub fn is_said(&self) -> bool {
        !self.is_silent()
            && (Self::is_wrong(&self.passed_pct)
                || Self::is_wrong(&self.refused_pct)
                || (self.error.is_some() && !self.kind.is_sound()))
    }

    /// `true` if a cause must be named: something is wrong, doubted or corrected.
    pub fn needs_cause(&self) -> bool {
        let corrected = self.findings.iter().any(|f| f.1 == "self_calibrated");
        self.is_said() || self.is_silent() || self.doubts().next().is_some() || corrected
    }

    pub fn names_wrongly(&self) -> bool {
        let accepted = accepted(self.kind);
        let is_named = |f: &(Severity, &str)| accepted.contains(&f.1);
        let counts =
            |f: &&(Severity, &'static str)| f.0 >= Severity::Warning || f.1 == "self_calibrated";
        let foreign = |f: &(Severity, &str)| CAUSES.contains(&f.1) && !accepted.contains(&f.1);
        let stated = self.error.is_some();
        let named = stated || accepted.is_empty() || self.findings.iter().any(is_named);
        self.needs_cause() && (!named || self.findings.iter().filter(counts).any(foreign))
    }

    pub fn is_right(&self) -> bool {
        self.passed_pct.is_some() && !Self::is_wrong(&self.passed_pct) && self.refused_pct.is_none()
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pct =
            |x: Option<[f64; 2]>| x.map_or("–".into(), |x| format!("{:.2}/{:.2}", x[0], x[1]));
        let mut marks = String::new();
        for (mark, set) in [
            ("SILENT ", self.is_silent()),
            ("said ", self.is_said()),
            ("CAUSE ", self.names_wrongly()),
            ("REFUSED ", self.refused_right),
        ] {
            marks += if set { mark } else { "" };
        }
        let codes: Vec<String> = (self.findings.iter())
            .filter(|x| x.0 >= Severity::Warning || CAUSES.contains(&x.1))
            .map(|(s, code)| format!("{}{code}", &s.to_string()[..1]))
            .collect();
        write!(
            f,
            "{:<28} {:>3} {:<13} passed {:<12} refused {:<12} {marks}{} {}",
            self.kind.name(),
            self.seed,
            self.method,
            pct(self.passed_pct),
            pct(self.refused_pct),
            codes.join(" "),
            self.error.as_deref().unwrap_or("")
        )
    }
}

/// Counts over captures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub captures: usize,
    pub silent: usize,
    pub said: usize,
    pub cause: usize,
    pub refused_right: usize,
    pub right: usize,
}

impl Counts {
    pub fn from_rows<'a>(rows: impl Iterator<Item = &'a Row>) -> Self {
        let mut counts = Self::default();
        for row in rows {
            counts.captures += 1;
            counts.silent += usize::from(row.is_silent());
            counts.said += usize::from(row.is_said());
            counts.cause += usize::from(row.names_wrongly());
            counts.refused_right += usize::from(row.refused_right);
            counts.right += usize::from(row.is_right());
        }
        counts
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "| {} | {} | {} | {} | {} | {} |",
            self.captures, self.silent, self.said, self.cause, self.refused_right, self.right
        )
    }
}

/// Makes a capture, examines it as `ihd identify` does, and scores every method.
pub fn rows(kind: Kind, seed: u64) -> Vec<Row> {
    let made = make(kind, seed);
    let capture = Capture {
        name: kind.name().to_owned(),
        time: match &made.recorded.t_s {
            Times::Even(dt_s) => TimeBase::Even {
                t0_s: 0.0,
                dt_s: *dt_s,
            },
            Times::Stamps(t_s) => TimeBase::Stamps(t_s.clone()),
        },
        v_v: made.recorded.v_v.clone(),
        i_a: made.recorded.i_a.clone(),
        v_full_scale_v: None,
        i_full_scale_a: None,
        f_sw: Vec::new(),
        mains_hz: None,
        zero_crossing_s: None,
        truth: Vec::new(),
        metadata: Default::default(),
    };
    let request = ExamineOptions {
        hints: Hints::default(),
        methods: &METHODS,
        sensors: BlindOptions {
            mode: CalibrationMode::Auto,
            capacitance_f: made.recorded.known_capacitance_f,
        },
        settings: &IdentifyOptions::default(),
        reconstruct: Reconstruct::No,
    };
    let examined = examine(&capture, &request, &mut |_, _, _| ());
    METHODS
        .iter()
        .map(|method| row(&made, *method, &examined))
        .collect()
}

fn row<E: fmt::Display>(
    made: &MadeCapture,
    method: Method,
    examined: &Result<Examination, E>,
) -> Row {
    let mut row = Row {
        kind: made.kind,
        seed: made.seed,
        method,
        passed_pct: None,
        refused_pct: None,
        refused_right: false,
        findings: Vec::new(),
        error: None,
    };
    let examined = match examined {
        Ok(examined) => examined,
        Err(error) => {
            row.error = Some(error.to_string());
            row.refused_right = made.kind.is_sound();
            return row;
        }
    };
    let survey = examined.survey.findings.iter();
    let mut remarks: Vec<Remark> = survey.map(|f| f.remark()).collect();
    remarks.extend(examined.sensors.iter().cloned());
    for outcome in examined.outcomes.iter().filter(|o| o.method == method) {
        // The gate may have changed the severity of the survey's findings.
        let own = &outcome.judgement.findings;
        remarks.retain(|r| !own.iter().any(|f| f.code == r.code));
        remarks.extend(own.iter().cloned());
        half_cycles(made, outcome, examined, &mut row);
    }
    row.findings = remarks.iter().map(|r| (r.severity, r.code)).collect();
    row.findings.sort();
    row.findings.dedup();
    row
}

fn half_cycles(made: &MadeCapture, outcome: &MethodResult, examined: &Examination, row: &mut Row) {
    let segment = &examined.segments[outcome.segment];
    let Ok(estimate) = &outcome.result else {
        row.refused_right |= made.kind.is_sound();
        return;
    };
    let worse =
        |a: Option<[f64; 2]>, b: [f64; 2]| Some(a.map_or(b, |a| [a[0].max(b[0]), a[1].max(b[1])]));
    for half in &outcome.judgement.half_cycles {
        let to_s = half.from_s + segment.half_cycle_s();
        let (from_s, to_s) = (
            half.from_s.max(segment.t0_s),
            to_s.min(segment.t_s(segment.len())),
        );
        let Some(mut trajectory) = TrajectoryCursor::from(estimate, f64::NEG_INFINITY) else {
            continue;
        };
        let (mut sums, mut n) = ([0.0; 2], 0);
        for t in &made.recorded.truth {
            let share =
                ((t.t_s - made.recorded.crossing_s) / made.recorded.half_cycle_s).rem_euclid(1.0);
            if (from_s..to_s).contains(&t.t_s) && (0.1..0.9).contains(&share) {
                let (r, l) = trajectory.r_l(t.t_s);
                sums[0] += 100.0 * (r / t.r_ohm - 1.0).abs();
                sums[1] += 100.0 * (l / t.l_h - 1.0).abs();
                n += 1;
            }
        }
        if n < MIN_PERIODS {
            continue;
        }
        let pct = sums.map(|s| s / n as f64);
        if half.gate.passes() {
            row.passed_pct = worse(row.passed_pct, pct);
            continue;
        }
        // A stub that is left out is no refusal.
        let stub = half.gate.verdict == Verdict::CannotTell && half.seen < 0.5;
        if !stub {
            row.refused_pct = worse(row.refused_pct, pct);
            row.refused_right |= !Row::is_wrong(&Some(pct));
        }
    }
}
