//! Makes tests/fixtures/captures: `cargo run --release -p ihd-tests --example make_captures`, then
//! `UPDATE_THRESHOLDS=1 cargo test -p ihd-tests regression` and a look at what changed.

use ihd_sim::recording::file::write;
use ihd_sim::recording::run::record;
use ihd_tests::regression_captures::{TRUTH_EVERY, all, file, folder};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder())?;
    for (name, settings) in all() {
        let mut recording = record(&settings, |_| ())?;
        let mut period = 0;
        recording.truth.retain(|t| {
            period += 1;
            period % TRUTH_EVERY == 0 && t.r_ohm[0].is_finite()
        });
        write(&recording, &file(name), false)?;
        let bytes = std::fs::metadata(file(name))?.len();
        println!(
            "{name:16} {:6} pairs, {bytes:6} bytes",
            recording.v_code.len()
        );
    }
    Ok(())
}
