//! The four-state EKF on a capture that peers in other languages read too: writes `data.f64` (pairs of
//! current and voltage, little-endian) and `model.json` into a folder, times its own passes and prints
//! them as JSON. `host/identify/benches/peers/compare.py` runs it.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use ihd_identify::IdentifyOptions;
use ihd_identify::ekf::PreparedSegment;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::trial::Trial;

/// Passes of which the fastest counts.
const PASSES: u32 = 10;

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let folder = args.next().context("usage: ekf_peer FOLDER [SAMPLES]")?;
    let samples: usize = args.next().map_or(Ok(1_000_000), |n| n.parse())?;
    let capture = Trial::simulate(LoadKind::Behavioural, 45e3)?.noisy(Some(30.0), 1);
    ensure!(
        samples <= capture.len(),
        "at most {} samples",
        capture.len()
    );
    let mut prepared = PreparedSegment::new(&capture, &IdentifyOptions::default());
    prepared.i.truncate(samples);
    prepared.v.truncate(samples);
    let pairs = prepared.i.iter().zip(&prepared.v);
    let bytes: Vec<u8> = pairs
        .flat_map(|(i, v)| [i.to_le_bytes(), v.to_le_bytes()].concat())
        .collect();
    let folder = Path::new(&folder);
    std::fs::write(folder.join("data.f64"), bytes)?;
    let (model, start) = (&prepared.model, &prepared.start);
    let text = serde_json::json!({
        "f12": model.f12, "q": model.q, "r": model.r, "x0": start.x, "p0": start.p,
    });
    std::fs::write(folder.join("model.json"), text.to_string())?;
    let (mut best_s, mut filter) = (f64::INFINITY, *start);
    for _ in 0..PASSES {
        filter = *start;
        let started = Instant::now();
        for (i, v) in prepared.i.iter().zip(&prepared.v) {
            filter.step(model, *i, *v);
        }
        best_s = best_s.min(started.elapsed().as_secs_f64());
    }
    let report = serde_json::json!({ "seconds": best_s, "samples": samples, "x": filter.x });
    println!("{report}");
    Ok(())
}
