//! Writes a capture of a sound hob, with a pot that the seed draws, for host/identify/peers/compare.py.
//!
//! `pot F_SW_KHZ SNR_DB SEED FILE`; SNR_DB is `inf` without noise.

use std::path::Path;

use anyhow::{Context, bail};
use ihd_made_captures::{Plan, Recorded, Times, Truth};
use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, FrequencyStep, TimeBase};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [khz, snr_db, seed, file] = arguments.as_slice() else {
        bail!("usage: pot F_SW_KHZ SNR_DB SEED FILE");
    };
    let f_sw_hz = 1e3 * khz.parse::<f64>().context("F_SW_KHZ")?;
    let snr_db = snr_db.parse().context("SNR_DB")?;
    let seed = seed.parse().context("SEED")?;
    let recorded = Plan::of_pot(seed, f_sw_hz, snr_db).record(seed);
    let Times::Even(dt_s) = recorded.t_s else {
        bail!("a sound hob has no stamps");
    };
    let capture = capture(recorded, f_sw_hz, dt_s);
    ihd_capture::write(&capture, Path::new(file), &mut |_| ()).context("capture")
}

fn capture(recorded: Recorded, f_sw_hz: f64, dt_s: f64) -> Capture {
    Capture {
        name: "pot".to_owned(),
        time: TimeBase::Even { t0_s: 0.0, dt_s },
        f_sw: vec![FrequencyStep { t_s: 0.0, f_sw_hz }],
        mains_hz: Some(0.5 / recorded.half_cycle_s),
        zero_crossing_s: Some(recorded.crossing_s),
        truth: recorded
            .truth
            .iter()
            .map(|t| of_period(t, f_sw_hz))
            .collect(),
        v_v: recorded.v_v,
        i_a: recorded.i_a,
        ..Capture::default()
    }
}

/// Truth of the fundamental; nothing is known of harmonics and power.
fn of_period(truth: &Truth, f_sw_hz: f64) -> PeriodTruth {
    let of_first = |x: f64| std::array::from_fn(|n| if n == 0 { x } else { f64::NAN });
    PeriodTruth {
        t_s: truth.t_s,
        f_sw_hz,
        r_ohm: of_first(truth.r_ohm),
        l_h: of_first(truth.l_h),
        i_a: truth.i_a,
        r_power_ohm: f64::NAN,
        p_w: f64::NAN,
    }
}
