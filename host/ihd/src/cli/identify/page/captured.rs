//! Part of the report on the capture: files, channels, times, and how it was read.

use std::collections::BTreeMap;

use ihd_gate::Examination;
use ihd_signal::Capture;
use ihd_survey::ChannelSurvey;

use super::super::super::capture_args::CaptureArgs;
use super::html::{TableColumn, TableRow, table};

/// Facts on the capture, gathered part by part.
pub struct CapturedFacts {
    files: Vec<String>,
    given: String,
    pairs: usize,
    span_s: Option<(f64, f64)>,
    rate_hz: f64,
    mains: String,
    /// Lowest and highest switching frequency.
    f_sw_hz: Option<(f64, f64)>,
    channels: [Option<ChannelSurvey>; 2],
    full_scale: [Option<f64>; 2],
    metadata: BTreeMap<String, String>,
    /// Corrections of the sensors.
    corrections: Vec<String>,
}

impl CapturedFacts {
    /// Facts known before the samples are.
    pub fn new(args: &CaptureArgs) -> Self {
        Self {
            files: args.paths().map(|p| p.display().to_string()).collect(),
            given: args.given(),
            pairs: 0,
            span_s: None,
            rate_hz: 0.0,
            mains: String::new(),
            f_sw_hz: None,
            channels: [None, None],
            full_scale: [None; 2],
            metadata: BTreeMap::new(),
            corrections: Vec::new(),
        }
    }

    /// Names of the files.
    pub fn files(&self) -> String {
        self.files.join(", ")
    }

    /// Adds a part.
    pub fn take(&mut self, capture: &Capture, examined: &Examination) {
        let survey = &examined.survey;
        self.pairs += survey.samples;
        let (from_s, to_s) = (survey.start_s, survey.start_s + survey.duration_s);
        self.span_s = Some((self.span_s.map_or(from_s, |s| s.0), to_s));
        self.rate_hz = survey.rate_hz;
        self.mains = format!("{:.2} Hz ({})", survey.mains.hz, survey.mains.hz_source);
        for segment in &examined.segments {
            let f = segment.f_sw_hz;
            let (low, high) = self.f_sw_hz.unwrap_or((f, f));
            self.f_sw_hz = Some((low.min(f), high.max(f)));
        }
        let of_part = [&survey.voltage, &survey.current];
        for (all, part) in self.channels.iter_mut().zip(of_part) {
            match all {
                None => *all = Some(*part),
                Some(all) => join(all, part),
            }
        }
        self.full_scale = [capture.v_full_scale_v, capture.i_full_scale_a];
        self.metadata.clone_from(&capture.metadata);
        for remark in examined.sensors_to_report() {
            if remark.code == "self_calibrated" && !self.corrections.contains(&remark.text) {
                self.corrections.push(remark.text.clone());
            }
        }
    }

    /// Tables of the facts; `calibration` is the line on the sensors' calibration.
    pub fn html(&self, calibration: &str) -> String {
        let (from_s, to_s) = self.span_s.unwrap_or_default();
        let f_sw = match self.f_sw_hz {
            Some((low, high)) if high - low > 1.0 => {
                format!("{:.3} to {:.3} kHz", low * 1e-3, high * 1e-3)
            }
            Some((low, _)) => format!("{:.3} kHz", low * 1e-3),
            None => "–".into(),
        };
        let mut facts = vec![
            ("Files", self.files()),
            ("Pairs of samples", self.pairs.to_string()),
            ("Sampling rate", format!("{:.3} MS/s", self.rate_hz * 1e-6)),
            (
                "Time",
                format!("{:.3} to {:.3} ms", from_s * 1e3, to_s * 1e3),
            ),
            ("Switching frequency", f_sw),
            ("Mains", self.mains.clone()),
        ];
        if !self.given.is_empty() {
            facts.push(("Read with --input", self.given.clone()));
        }
        if !calibration.is_empty() {
            facts.push(("Calibration", calibration.trim_end().to_owned()));
        }
        let corrections = self.corrections.iter();
        facts.extend(corrections.map(|text| ("Corrected", text.clone())));
        let fact = |(name, value): (&str, String)| plain(vec![name.to_owned(), value]);
        let mut rows: Vec<TableRow> = facts.into_iter().map(fact).collect();
        let metadata = self.metadata.iter();
        rows.extend(metadata.map(|(key, value)| plain(vec![key.clone(), value.clone()])));
        let columns = [TableColumn::Text("Capture"), TableColumn::Long("")];
        table(&columns, &rows) + "<p></p>\n" + &self.channels_html()
    }

    fn channels_html(&self) -> String {
        let columns = [
            TableColumn::Text("Channel"),
            TableColumn::Number("from"),
            TableColumn::Number("to"),
            TableColumn::Number("full scale"),
            TableColumn::Number("SNR dB"),
            TableColumn::Number("samples at the end of the range"),
        ];
        let row = |(k, name): (usize, &&str)| {
            let channel = self.channels[k].as_ref()?;
            Some(plain(vec![
                (*name).to_owned(),
                format!("{:.2}", channel.min),
                format!("{:.2}", channel.max),
                self.full_scale[k].map_or("–".into(), |x| format!("{x:.2}")),
                channel.snr_db.map_or("–".into(), |x| format!("{x:.1}")),
                channel.clipped.to_string(),
            ]))
        };
        let names = ["Voltage V", "Current A"];
        let rows: Vec<TableRow> = names.iter().enumerate().filter_map(row).collect();
        table(&columns, &rows)
    }
}

fn plain(cells: Vec<String>) -> TableRow {
    TableRow { class: "", cells }
}

/// Joins the numbers of a later part: the whole range, the lowest SNR.
fn join(all: &mut ChannelSurvey, part: &ChannelSurvey) {
    (all.min, all.max) = (all.min.min(part.min), all.max.max(part.max));
    all.clipped += part.clipped;
    all.snr_db = match (all.snr_db, part.snr_db) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    };
}
