//! Output of `ihd inspect`.

use std::fmt::Write;

use ihd_capture::lone::LoneChannel;
use ihd_signal::{Capture, Remark};
use ihd_survey::calibration::blind::{CalibratedCapture, Correction, SelfCalibration};
use ihd_survey::{ChannelSurvey, Finding, Severity, Survey};
use serde::Serialize;

use crate::report::table::TextTable;

/// Finding with its text.
#[derive(Serialize)]
struct ReportedFinding<'a> {
    severity: Severity,
    text: String,
    #[serde(flatten)]
    finding: &'a Finding,
}

/// Survey as one JSON object; its numbers in the units in their names.
pub fn json<'a>(
    calibrated: &'a CalibratedCapture<'a>,
    sensors: &'a [Remark],
    incomplete: Option<String>,
) -> impl Serialize + 'a {
    let survey = &calibrated.survey;
    #[derive(Serialize)]
    struct Report<'a> {
        #[serde(flatten)]
        survey: &'a Survey,
        findings: Vec<ReportedFinding<'a>>,
        /// Self-calibration of the sensors.
        #[serde(skip_serializing_if = "Option::is_none")]
        self_calibration: Option<&'a SelfCalibration>,
        /// Correction applied.
        #[serde(skip_serializing_if = "Option::is_none")]
        correction: Option<Correction>,
        /// Findings on the sensors.
        sensors: &'a [Remark],
        /// Losses of the file.
        #[serde(skip_serializing_if = "Option::is_none")]
        incomplete: Option<String>,
    }
    let reported = |finding| ReportedFinding {
        severity: Finding::severity(finding),
        text: finding.to_string(),
        finding,
    };
    Report {
        survey,
        findings: survey.findings.iter().map(reported).collect(),
        self_calibration: calibrated.sensors.as_ref().and_then(|s| s.as_ref().ok()),
        correction: calibrated.correction,
        sensors,
        incomplete,
    }
}

/// One channel as one JSON object.
pub fn lone_json(lone: &LoneChannel) -> impl Serialize {
    serde_json::json!({
        "format": lone.format,
        "channel": lone.name,
        "unit": lone.unit,
        "full_scale": lone.full_scale,
        "samples": lone.samples,
        "rate_hz": lone.rate_hz,
        "start_s": lone.start_s,
        "duration_s": lone.duration_s,
        "min": lone.min,
        "max": lone.max,
        "mean": lone.mean,
        "rms": lone.rms,
    })
}

/// One channel as text.
pub fn lone_text(lone: &LoneChannel) -> String {
    let unit = lone.unit.as_deref().unwrap_or("(no unit)");
    let name = if lone.name.is_empty() {
        "(no name)"
    } else {
        &lone.name
    };
    let rate = lone.rate_hz.map_or("uneven times".to_owned(), |hz| {
        format!("{:.4} MS/s", hz * 1e-6)
    });
    let time = match (lone.start_s, lone.duration_s) {
        (Some(from), Some(length)) => {
            format!("{rate}, {:.3} ms from {:.3} ms", length * 1e3, from * 1e3)
        }
        _ => "no time in the file".to_owned(),
    };
    let range = lone
        .full_scale
        .map_or(String::new(), |full| format!(" of ±{full:.4} {unit}"));
    format!(
        "format     {}\nchannel    {name}, in {unit}\nsamples    {}, {time}\n\
         values     {:.4} to {:.4} {unit}{range}, {:.4} {unit} rms, mean {:.4} {unit}\n",
        lone.format, lone.samples, lone.min, lone.max, lone.rms, lone.mean
    )
}

/// Survey as text.
pub fn text(capture: &Capture, survey: &Survey, sensors: &[Remark]) -> String {
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<10} {text}");
    };
    line("capture", survey.name.clone());
    line(
        "samples",
        format!(
            "{} pairs at {:.4} MS/s, {:.3} ms from {:.3} ms",
            survey.samples,
            survey.rate_hz * 1e-6,
            survey.duration_s * 1e3,
            survey.start_s * 1e3
        ),
    );
    line(
        "voltage",
        channel(&survey.voltage, "V", capture.v_full_scale_v),
    );
    line(
        "current",
        channel(&survey.current, "A", capture.i_full_scale_a),
    );
    line("mains", mains(survey));
    if let [span] = &survey.spans[..] {
        line(
            "switching",
            format!(
                "{:.3} kHz, {:.2} samples a period",
                span.f_sw_hz * 1e-3,
                1.0 / (span.f_sw_hz * span.dt_s)
            ),
        );
        if let Some(z) = span.load {
            let text = format!(
                "R {:.3} ohm, L {:.2} µH (fundamental)",
                z.r_ohm,
                z.l_h * 1e6
            );
            line("load", text);
        }
    } else {
        line("switching", format!("{} stretches", survey.spans.len()));
    }
    if let Some(note) = survey.skew_note() {
        line("skew", note);
    }
    for remark in sensors {
        let word = match remark.severity {
            Severity::Info => "sensors".to_owned(),
            worse => worse.to_string(),
        };
        line(&word, remark.text.clone());
    }
    let is_sound = sensors.iter().all(|r| r.severity == Severity::Info);
    if survey.findings.is_empty() && is_sound {
        line("findings", "none".to_owned());
    }
    for finding in &survey.findings {
        line(&finding.severity().to_string(), finding.to_string());
    }
    if survey.spans.len() > 1 {
        out.push('\n');
        out.push_str(&spans(survey));
    }
    out
}

fn channel(c: &ChannelSurvey, unit: &str, full_scale: Option<f64>) -> String {
    let snr = match (c.snr_db, c.noise) {
        (Some(db), Some(noise)) => format!("SNR {db:.1} dB (noise {noise:.3} {unit})"),
        _ => "SNR unknown".to_owned(),
    };
    let range = full_scale.map_or(String::new(), |full| format!(" of ±{full:.0} {unit}"));
    format!(
        "{:.2} to {:.2} {unit}{range}, {:.3} {unit} rms, mean {:.3} {unit}, {snr}, {} clipped",
        c.min, c.max, c.rms, c.mean, c.clipped
    )
}

fn mains(survey: &Survey) -> String {
    let m = &survey.mains;
    format!(
        "{:.2} Hz ({}), zero crossing at {:.3} ms ({}), {} whole half-cycles",
        m.hz,
        m.hz_source,
        // Avoids a minus before a zero.
        m.zero_crossing_s * 1e3 + 0.0,
        m.zero_crossing_source,
        survey.half_cycles_s.len()
    )
}

/// One row per stretch.
fn spans(survey: &Survey) -> String {
    let mut table = TextTable::new(&["from ms", "to ms", "f_sw kHz", "S/period", "R ohm", "L µH"]);
    for span in &survey.spans {
        let load = |value: fn(&ihd_signal::Load) -> f64| {
            span.load
                .as_ref()
                .map_or("–".to_owned(), |z| format!("{:.3}", value(z)))
        };
        table.row([
            format!("{:.3}", span.t0_s * 1e3),
            format!("{:.3}", span.end_s() * 1e3),
            format!("{:.3}", span.f_sw_hz * 1e-3),
            format!("{:.2}", 1.0 / (span.f_sw_hz * span.dt_s)),
            load(|z| z.r_ohm),
            load(|z| z.l_h * 1e6),
        ]);
    }
    table.render()
}
