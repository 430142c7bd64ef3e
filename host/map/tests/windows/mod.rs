//! Windows as a hob would give them to the map.

use ihd_map::{CurrentCurve, MeasuredPoint};
use ihd_signal::Load;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A window at 40 dB, .3 % of R and .15 % of L a point at the crest: R and L of `load` at 60 currents of a rising flank up to `most_a`, in ampere.
pub fn window(
    (f_hz, most_a): (f64, f64),
    t_s: f64,
    load: impl Fn(f64) -> Load,
    rng: &mut ChaCha8Rng,
) -> CurrentCurve {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let points: Vec<_> = (0..60)
        .map(|n| {
            let i_a = most_a * (std::f64::consts::PI * (f64::from(n) + 0.5) / 120.0).sin();
            let z = load(i_a);
            let sigma = 0.003 * most_a / i_a;
            MeasuredPoint {
                i_a,
                r_ohm: z.r_ohm * (1.0 + sigma * normal()),
                l_h: z.l_h * (1.0 + 0.5 * sigma * normal()),
                r_sigma_ohm: z.r_ohm * sigma,
                l_sigma_h: z.l_h * 0.5 * sigma,
            }
        })
        .collect();
    CurrentCurve::new(f_hz, t_s, points.into_iter())
}
