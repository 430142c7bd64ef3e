//! Output of `ihd simulate`.

use std::time::Duration;

use anyhow::Result;
use ihd_field::approximation;
use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_signal::ORDERS;
use ihd_signal::truth::PeriodTruth;
use ihd_sim::recording::comparison;
use ihd_sim::recording::prepared;
use ihd_sim::recording::run::SimulatedRecording;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, PRESETS};

use crate::report::recording::SMALLEST_A;

fn range(truth: &[&PeriodTruth], value: impl Fn(&PeriodTruth) -> f64) -> (f64, f64) {
    truth
        .iter()
        .map(|t| value(t))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
            (a.min(x), b.max(x))
        })
}

/// Mean power over a simulation in watt. The points between the first and the last are means over two periods that overlap, so that
/// those two count half.
fn mean_power_w(truth: &[PeriodTruth]) -> f64 {
    let (mut energy_j, mut time_s) = (0.0, 0.0);
    for (k, t) in truth.iter().enumerate() {
        let is_end = k == 0 || k + 1 == truth.len();
        let share_s = if is_end { 0.5 } else { 1.0 } / t.f_sw_hz;
        energy_j += share_s * t.p_w;
        time_s += share_s;
    }
    energy_j / time_s
}

/// Mean power over mean square of the current. In one period the coil's energy may rise or fall by more than an empty coil's losses.
fn r_power_ohm(periods: &[&PeriodTruth]) -> f64 {
    let known = periods.iter().filter(|t| t.r_power_ohm != 0.0);
    let (power, square) = known.fold((0.0, 0.0), |(power, square), t| {
        (power + t.p_w, square + t.p_w / t.r_power_ohm)
    });
    power / square
}

/// Summary with operating point, truth, resonance interval and speed.
pub fn summary(recording: &SimulatedRecording, took: Duration) -> Result<()> {
    let s = &recording.settings;
    say!(
        "simulated  {} at {} kHz, {} Hz mains, {} ms, seed {}",
        s.pot,
        s.f_sw_hz / 1e3,
        s.mains_hz,
        s.duration_s * 1e3,
        s.seed
    )?;
    say!(
        "samples    {} of {} bit; {:.2} s, real time / {:.0}",
        recording.v_code.len(),
        s.sensing.bits,
        took.as_secs_f64(),
        took.as_secs_f64() / s.duration_s
    )?;
    let loaded: Vec<_> = recording
        .truth
        .iter()
        .filter(|t| t.i_a >= SMALLEST_A)
        .collect();
    let (_, peak_a) = range(&loaded, |t| t.i_a);
    if loaded.is_empty() {
        say!("current    none above {SMALLEST_A} A")?;
        return Ok(());
    }
    let power_w = mean_power_w(&recording.truth);
    say!(
        "current    up to {peak_a:.2} A (fundamental's amplitude, which may exceed the largest sample), mean power {power_w:.1} W"
    )?;
    let (r, l) = (range(&loaded, |t| t.r_ohm[0]), range(&loaded, |t| t.l_h[0]));
    say!(
        "truth      R {:.3} to {:.3} ohm, L {:.2} to {:.2} µH at {SMALLEST_A} A and more",
        r.0,
        r.1,
        l.0 * 1e6,
        l.1 * 1e6
    )?;
    let at_peak = loaded.iter().max_by(|a, b| a.i_a.total_cmp(&b.i_a));
    if let Some(peak) = at_peak {
        let list: Vec<_> = ORDERS
            .iter()
            .zip(peak.l_h)
            .map(|(h, l)| format!("{h}: {:.2}", l * 1e6))
            .collect();
        say!(
            "harmonics  L in µH at the largest current, {}; P/I_rms² {:.3} ohm in the mean",
            list.join(", "),
            r_power_ohm(&loaded)
        )?;
    }
    let capacitance_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
    let f_khz = |l_h: f64| 1e-3 / (std::f64::consts::TAU * (l_h * capacitance_f).sqrt());
    say!(
        "resonance  {:.1} to {:.1} kHz with {RESONANCE_CAPACITANCE_NF} nF (paper: 27 to 36 simulated, 29 to 34 measured)",
        f_khz(l.1),
        f_khz(l.0)
    )?;
    if s.load == LoadKind::Surrogate {
        table_error(recording)?;
    }
    Ok(())
}

fn table_error(recording: &SimulatedRecording) -> Result<()> {
    let s = &recording.settings;
    let models = prepared::field_models(&s.pot, s.winding_r_ohm)?;
    let error = prepared::surrogate_pot(&s.pot, s.winding_r_ohm)?.error(&models)?;
    say!(
        "table      off its describing function by up to {:.2} % of R, {:.2} % of L",
        error.r_pct,
        error.l_pct
    )?;
    Ok(())
}

/// List of the field model's approximations and their cost.
pub fn approximations() -> Result<()> {
    say!(
        "{:<54} {:>7} {:>6} {:>9} {:>9}",
        "approximation",
        "f/kHz",
        "I/A",
        "dR/%",
        "dL/%"
    )?;
    for c in approximation::all()? {
        say!(
            "{:<54} {:>7.1} {:>6.1} {:>9.4} {:>9.4}",
            c.what,
            c.f_hz / 1e3,
            c.i_a,
            c.r_pct,
            c.l_pct
        )?;
    }
    say!("\nresonance with {RESONANCE_CAPACITANCE_NF} nF in kHz at 0, 7, 40 and 60 A:")?;
    for r in approximation::resonances()? {
        let [a, b, c, d] = r.f_hz.map(|f| f / 1e3);
        let (law, turns) = (r.law, r.turns_calibration);
        say!("{law:<16} turns {turns:<5} {a:>6.1} {b:>6.1} {c:>6.1} {d:>6.1}")?;
    }
    say!("\nfield model in the circuit, second half-cycle, above 2 A, mean deviation in %:")?;
    say!(
        "{:<10} {:>12} {:>12} {:>12} {:>12}",
        "preset",
        "table R",
        "table L",
        "current",
        "P/I2 - R"
    )?;
    for (name, _) in PRESETS {
        let d = comparison::surrogate_against_field(&CaptureSpec::preset(name)?)?;
        say!(
            "{name:<10} {:>12.2} {:>12.2} {:>12.2} {:>12.2}",
            d.r_pct,
            d.l_pct,
            d.i_pct,
            d.power_r_pct
        )?;
    }
    Ok(())
}
