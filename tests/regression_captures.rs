//! The captures in tests/fixtures/captures: what each shows, and how it is made.

use std::path::{Path, PathBuf};

use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

/// Every so many periods of truth are kept: R and L change little within half a millisecond.
pub const TRUTH_EVERY: usize = 8;

/// Name and settings of every capture.
pub fn all() -> [(&'static str, CaptureSpec); 6] {
    let steps =
        [(10e-3, 52e3), (20e-3, 60e3)].map(|(t_s, f)| event(t_s, RecordingChange::Frequency(f)));
    [
        ("start-up", board(20e-3)),
        (
            "pot-removal",
            CaptureSpec {
                f_sw_hz: 50e3,
                events: vec![event(13e-3, RecordingChange::Pot(SimulatedPot::NONE))],
                ..board(20e-3)
            },
        ),
        (
            "frequency-steps",
            CaptureSpec {
                events: steps.to_vec(),
                ..board(30e-3)
            },
        ),
        (
            "saturation",
            sensed(|s| {
                // The current's crest is some 45 A.
                s.i_full_scale_a = 40.0;
            }),
        ),
        (
            "noisy",
            sensed(|s| {
                s.snr_db = Some(30.0);
            }),
        ),
        (
            "commensurate",
            sensed(|s| {
                // Twenty samples a period: every harmonic of the edges falls on another one.
                s.rate = Rate::Hz(20.0 * 45e3);
                s.allow_aliasing = true;
            }),
        ),
    ]
}

fn event(t_s: f64, change: RecordingChange) -> RecordingEvent {
    RecordingEvent { t_s, change }
}

/// Board's samples of a 21 cm pot at 45 kHz: 12 bit, f_sw·61/3, a pole at 500 kHz.
fn board(duration_s: f64) -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Surrogate,
        winding_r_ohm: 0.1,
        duration_s,
        sensing: Sensing {
            rate: Rate::Locked,
            bits: 12,
            pole_hz: 500e3,
            ..Sensing::default()
        },
        ..CaptureSpec::default()
    }
}

fn sensed(change: fn(&mut Sensing)) -> CaptureSpec {
    let mut settings = board(20e-3);
    change(&mut settings.sensing);
    settings
}

/// The folder of the captures and their thresholds.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/captures")
}

/// The file of a capture.
pub fn file(name: &str) -> PathBuf {
    folder().join(format!("{name}.mcap"))
}
