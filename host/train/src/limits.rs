//! Limits of this build's power control in physical units, for figures and pages.

use ihd_firmware::limits::{PLANNED_CURRENT_MA, RESONANCE_MARGIN_PERCENT};

/// Largest amplitude of the coil's current that power control plans with, in ampere.
pub fn planned_current_a() -> f64 {
    f64::from(PLANNED_CURRENT_MA) * 1e-3
}

/// Lowest switching frequency over the resonance frequency. The firmware states the margin as the tank's reactance over that of the
/// coil, 1 − (f₀/f)².
pub fn resonance_margin() -> f64 {
    let part = RESONANCE_MARGIN_PERCENT as f64 * 1e-2;
    1.0 / (1.0 - part).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_margin_the_reactance_is_the_firmwares_part_of_the_coils() {
        let (l_h, c_f) = (60e-6, 1.08e-6_f64);
        let omega = resonance_margin() / (l_h * c_f).sqrt();
        let part = (omega * l_h - 1.0 / (omega * c_f)) / (omega * l_h);
        assert!(
            (100.0 * part - RESONANCE_MARGIN_PERCENT as f64).abs() < 1e-9,
            "{part}"
        );
    }
}
