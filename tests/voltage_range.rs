//! Cost of the voltage channel's range: `cargo run -p ihd-tests --example voltage_range`
//! prints the figures behind docs/accuracy.md. 12 bit, f_adc = f_sw·61/3, a pole at 500 kHz, behavioural load; the
//! last of two half-cycles.

use ihd_identify::Method;
use ihd_identify::accuracy::Accuracy;
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use ihd_survey::{Hints, Survey};

const F_SW_HZ: [f64; 4] = [45e3, 50e3, 60e3, 70e3];

/// The firmware's own chain is of one range: its figures are those of `cargo test -p ihd-tests estimator`.
const METHODS: [Method; 2] = [Method::Lockin, Method::LeastSquares];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("| R / L, % | 45 kHz | 50 kHz | 60 kHz | 70 kHz |\n|---|---:|---:|---:|---:|");
    for method in METHODS {
        for v_full_scale_v in [400.0, 640.0] {
            let cells: Result<Vec<_>, _> = F_SW_HZ
                .iter()
                .map(|&f_sw_hz| cell(method, v_full_scale_v, f_sw_hz))
                .collect();
            let cells = cells?.join(" | ");
            println!("| {method}, ±{v_full_scale_v} V | {cells} |");
        }
    }
    Ok(())
}

/// Errors over the whole half-cycle and over its middle 80 %.
fn cell(
    method: Method,
    v_full_scale_v: f64,
    f_sw_hz: f64,
) -> Result<String, Box<dyn std::error::Error>> {
    let settings = CaptureSpec {
        f_sw_hz,
        load: LoadKind::Behavioural,
        duration_s: 20e-3,
        sensing: Sensing {
            rate: Rate::Locked,
            bits: 12,
            pole_hz: 500e3,
            v_full_scale_v,
            ..Sensing::default()
        },
        ..CaptureSpec::default()
    };
    let capture = record(&settings, |_| ())?.capture("voltage range");
    let survey = Survey::from_capture(&capture, &Hints::default())?;
    let segments = survey.segments(&capture);
    let segment = segments.first().ok_or("no segment")?;
    let estimate = ihd_identify::run(method, segment, &ihd_identify::IdentifyOptions::default())?;
    let accuracy =
        Accuracy::measure(&estimate, segment, &capture.truth, 10e-3).ok_or("no truth")?;
    let text = |e: ihd_signal::truth::Mre| format!("{:.3}/{:.3}", e.r_pct, e.l_pct);
    Ok(format!(
        "{} · {}",
        text(accuracy.whole),
        text(accuracy.middle)
    ))
}
