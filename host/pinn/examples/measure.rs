//! Prints error and time of `identify` on the exact load of the tests, for all settings that a
//! reader may want to compare. `cargo run --release -p ihd-pinn --example measure -- KEY=VALUE ...`;
//! `preset=paper-repaired rate=5e6` gives the paper's 50 000 points, `khz=45` one frequency; with
//! `warm=1` every seed after the first starts from the result before it, as the trainer does.

#[path = "../tests/it/truth.rs"]
mod truth;

use ihd_pinn::{PinnConfig, PresetLibrary, identify};
use truth::{Hob, mre_pct};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut json = serde_json::to_value(PinnConfig::default())?;
    let (mut snr_db, mut seeds, mut mains) = (None::<f64>, 1_u64, 50.0);
    let (mut rate_hz, mut only_khz, mut warm) = (None::<f64>, None::<f64>, false);
    for argument in std::env::args().skip(1) {
        let (key, value) = argument.split_once('=').ok_or("arguments are KEY=VALUE")?;
        match key {
            "preset" => json = serde_json::to_value(PresetLibrary::default().get(value)?.config)?,
            "downsampling" => json["vi_mlp"]["downsampling"] = value.parse::<usize>()?.into(),
            "rate" => rate_hz = Some(value.parse()?),
            "warm" => warm = value == "1",
            "khz" => only_khz = Some(value.parse()?),
            "snr" => snr_db = Some(value.parse()?),
            "seeds" => seeds = value.parse()?,
            "mains" => mains = value.parse()?,
            // Any field of Config, in JSON; plain words are strings.
            _ => json[key] = serde_json::from_str(value).unwrap_or_else(|_| value.into()),
        }
    }
    let mut config: PinnConfig = serde_json::from_value(json)?;
    println!(
        "kHz seed | whole R % L % | middle R % L % | sigma R % L % | passes steps ms stop | NMSE v i %"
    );
    let all_khz = [45.0, 50.0, 60.0, 70.0];
    for f_sw_khz in all_khz
        .into_iter()
        .filter(|f| only_khz.is_none_or(|only| only == *f))
    {
        let hob = Hob::at(f_sw_khz * 1e3, mains);
        config.start = None;
        for seed in 1..=seeds {
            config.seed = seed;
            let mut recording = match rate_hz {
                Some(rate_hz) => hob.record_at(rate_hz),
                None => hob.record(),
            };
            if let Some(snr_db) = snr_db {
                recording = recording.with_noise(snr_db, seed);
            }
            let recording = recording.quantised();
            let found = identify(&recording.waveform(), &config, &mut |_| {})?;
            config.start = warm.then(|| found.parameters.clone());
            let sigma = found.relative_sigma_pct().unwrap_or((f64::NAN, f64::NAN));
            let (whole, middle) = (mre_pct(&found, &hob, 0.0), mre_pct(&found, &hob, 0.1));
            println!(
                "{f_sw_khz} {seed:2} | {:.3} {:.3} | {:.3} {:.3} | {:.3} {:.3} | {} {:3} {:5.2} {} | \
                 {:.4} {:.4}",
                whole.0,
                whole.1,
                middle.0,
                middle.1,
                sigma.0,
                sigma.1,
                found.passes,
                found.iterations,
                1e3 * found.elapsed_s,
                found.stopped_because,
                found.nmse_v_pct,
                found.nmse_i_pct,
            );
        }
    }
    Ok(())
}
