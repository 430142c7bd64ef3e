//! Makes tests/fixtures/half_cycle: `cargo run -p ihd-tests --example make_fixtures`.
//!
//! The behavioural reference load, 50 Hz mains, the second half-cycle after switching on at a fixed frequency, 12 bit,
//! 61/3, behind the board's sensors and filters; noiseless, and with white noise of 30 dB by the paper's definition over that half-cycle
//! (seed 7).

use ihd_firmware::drive::bridge::Drive;
use ihd_shared::sampling::{AMPERE_PER_CODE, ANTI_ALIAS_HZ, Pair, VOLT_PER_CODE};
use ihd_sim::adc::{ConverterNoise, SimulatedAdc};
use ihd_sim::behavioural::PotKind;
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_sim::recording::settings::LoadKind;
use ihd_tests::half_cycle::{F_SW_HZ, HalfCycle};

/// Points of the kept truth: every 40th sample.
const TRUTH_EVERY: usize = 40;

fn record(f_sw_hz: u32, noise: ConverterNoise) -> HalfCycle {
    let mains = SimulatedMains::new(50.0);
    let half_s = mains.half_cycle_s();
    let (pot, load) = (PotKind::Ferromagnetic.into(), LoadKind::Behavioural);
    let adc = SimulatedAdc::of_board(noise, 7, f64::from(ANTI_ALIAS_HZ));
    let mut plant =
        Plant::assemble(mains, pot, load, SupplyParts::NONE, adc).expect("a law has every pot");
    plant.set_drive(Drive::switching(f_sw_hz));
    let (mut pairs, mut truth): (Vec<Pair>, _) = (Vec::new(), Vec::new());
    while plant.t_s() < 2.0 * half_s {
        // The window begins with the first whole block after the crossing at 10 ms.
        let inside = plant.t_s() >= half_s - 1e-9;
        let mut samples = 0;
        let block = plant.block(|plant| {
            if inside && samples % TRUTH_EVERY == 0 {
                let p = plant.load_point();
                truth.push((p.t_s - half_s, p.r_ohm, p.l_h));
            }
            samples += 1;
        });
        if inside {
            pairs.extend(block);
        }
    }
    HalfCycle {
        f_sw_hz,
        pairs,
        truth,
    }
}

fn main() -> std::io::Result<()> {
    for f_sw_hz in F_SW_HZ {
        let clean = record(f_sw_hz, ConverterNoise::default());
        let rms = |value: fn(&Pair) -> f64| {
            let sum: f64 = clean.pairs.iter().map(|p| value(p).powi(2)).sum();
            (sum / clean.pairs.len() as f64).sqrt()
        };
        let v_rms = rms(|p| f64::from(p.v) * VOLT_PER_CODE);
        let i_rms = rms(|p| f64::from(p.i) * AMPERE_PER_CODE);
        println!("{f_sw_hz} Hz: v_rms {v_rms:.1} V, i_rms {i_rms:.2} A");
        clean.save("noiseless")?;
        record(f_sw_hz, ConverterNoise::from_snr_db(30.0, v_rms, i_rms)).save("snr30")?;
    }
    Ok(())
}
