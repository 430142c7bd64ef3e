//! The noise measured between the harmonics, on captures with known noise.

use ihd_signal::noise::WhiteNoise;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::trial::Trial;

#[test]
fn noise_is_separated_from_the_harmonics_of_a_modulated_square_wave() {
    let trial = Trial::simulate(LoadKind::Behavioural, 45e3).unwrap();
    for (snr_db, tolerance) in [(30.0, 0.25), (50.0, 0.25), (65.0, 0.35)] {
        let rms = |x: &[f64]| (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
        let found = WhiteNoise::measure(&trial.noisy(Some(snr_db), 3));
        let ratio = libm::pow(10.0, -snr_db / 20.0);
        let (v, i) = (rms(&trial.clean.v_v) * ratio, rms(&trial.clean.i_a) * ratio);
        assert!(
            (found.v_v / v - 1.0).abs() < tolerance,
            "{snr_db}: {} {v}",
            found.v_v
        );
        assert!(
            (found.i_a / i - 1.0).abs() < tolerance,
            "{snr_db}: {} {i}",
            found.i_a
        );
    }
}
