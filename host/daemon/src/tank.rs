//! Series resonance tank of coil, pot and capacitor.

use std::f64::consts::TAU;

use ihd_shared::hob::TANK_CAPACITANCE_PF;

/// Capacitance in series with the coil, in farad: that of the firmware's frequency limit.
pub const C_F: f64 = TANK_CAPACITANCE_PF as f64 * 1e-12;

/// Returns the phase lead of the inverter's voltage over its current in degree, from R in ohm, L in henry and the switching
/// frequency in hertz; `None` if the frequency is not positive.
pub fn phase_deg(r_ohm: f64, l_h: f64, f_sw_hz: f64) -> Option<f64> {
    let omega = TAU * f_sw_hz;
    let reactance_ohm = omega * l_h - (omega * C_F).recip();
    let phase = reactance_ohm.atan2(r_ohm).to_degrees();
    (f_sw_hz > 0.0 && phase.is_finite()).then_some(phase)
}

/// Returns the resonance frequency in hertz from L in henry; `None` if L is not positive.
pub fn resonance_hz(l_h: f64) -> Option<f64> {
    (l_h > 0.0).then(|| (TAU * (l_h * C_F).sqrt()).recip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_resonance_the_phase_is_zero_and_above_it_is_positive() {
        // C2 / (1/2 − 2/π²) = 4.7 µF / .297358 = 15.806 µF in series with 1.08 µF is 1.01092 µF, which resonates with 30 µH at
        // 28 900.15 Hz.
        let f_hz = resonance_hz(30e-6).unwrap();
        assert!((f_hz - 28_900.15).abs() < 0.1, "{f_hz}");
        assert!(phase_deg(2.0, 30e-6, f_hz).unwrap().abs() < 1e-9);
        // X = 2π · 45 kHz · 30 µH − 1 / (2π · 45 kHz · 1.01092 µF) = 8.48230 − 3.49856 = 4.98374 Ω.
        let above = phase_deg(4.98374, 30e-6, 45e3).unwrap();
        assert!((above - 45.0).abs() < 0.001, "{above}");
        assert!(phase_deg(2.0, 30e-6, 20e3).unwrap() < 0.0);
        assert_eq!(
            (phase_deg(2.0, 30e-6, 0.0), resonance_hz(0.0)),
            (None, None)
        );
        assert_eq!(resonance_hz(-1e-6), None);
    }
}
