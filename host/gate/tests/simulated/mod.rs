//! Captures that the simulator makes for this crate's tests; those beside its code include this file by its path.

use ihd_signal::Capture;
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};

/// Two half-cycles of the behavioural load at 45 kHz, 12.5 MS/s, 12 bit, 50 dB.
pub fn clean() -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Behavioural,
        sensing: Sensing {
            rate: Rate::Hz(12.5e6),
            bits: 12,
            snr_db: Some(50.0),
            ..Sensing::default()
        },
        ..CaptureSpec::default()
    }
}

/// Records a capture without the facts that a user's scope does not know.
pub fn capture(settings: &CaptureSpec) -> Capture {
    let recording = record(settings, |_| ()).expect("settings that can be");
    Capture {
        mains_hz: None,
        zero_crossing_s: None,
        ..recording.capture("a test")
    }
}
