//! Heat of a pot as a process in time: ln s = ln √(µ/σ) follows the temperature, a stationary normal process whose rate lasts for a
//! time. Changes within close times are nearly one change, and none exceeds what a pot's heat allows.

/// Standard deviation of the rate of ln s per second: 2 K/s times half of 1.1e-3 per kelvin (docs/map.md).
const PER_S: f64 = 1e-3;

/// Time in seconds for which a rate lasts. The largest change then has a deviation of .15, some 270 K.
const LASTS_S: f64 = 106.0;

/// Covariance of the changes of ln s from now to two times, in seconds of age.
pub(crate) fn changes(a_s: f64, b_s: f64) -> f64 {
    let spread = PER_S * LASTS_S;
    let correlation = |apart_s: f64| {
        let x = apart_s.abs() / LASTS_S;
        (1.0 + x) * (-x).exp()
    };
    let moved = 1.0 - correlation(a_s) - correlation(b_s) + correlation(a_s - b_s);
    spread * spread * moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_grows_with_the_rate_and_ends() {
        let deviation = |a_s: f64| changes(a_s, a_s).sqrt();
        assert!((deviation(1.0) / PER_S - 1.0).abs() < 0.01);
        assert!(deviation(60.0) < 60.0 * PER_S);
        assert!((deviation(1e9) - 0.15).abs() < 1e-3);
        // Two seconds of one minute ago have seen nearly the same.
        let correlation = changes(60.0, 62.0) / (deviation(60.0) * deviation(62.0));
        assert!((0.999..1.0).contains(&correlation), "{correlation}");
        assert_eq!(changes(0.0, 60.0), 0.0);
    }
}
