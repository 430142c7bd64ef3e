//! Series resonance tank of coil, pot and capacitor.

use std::f64::consts::TAU;

use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;

/// Capacitance of the resonance capacitor in farad.
pub const C_F: f64 = RESONANCE_CAPACITANCE_NF as f64 * 1e-9;

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
        // 1 / (2 pi sqrt(30 uH * 1.08 uF)) = 27 960 Hz.
        let f_hz = resonance_hz(30e-6).unwrap();
        assert!((f_hz - 27_960.5).abs() < 1.0, "{f_hz}");
        assert!(phase_deg(2.0, 30e-6, f_hz).unwrap().abs() < 1e-9);
        // X = 2 pi 45 kHz 30 uH - 1 / (2 pi 45 kHz 1.08 uF) = 8.4823 - 3.2748 = 5.2075 ohm.
        let above = phase_deg(5.2075, 30e-6, 45e3).unwrap();
        assert!((above - 45.0).abs() < 0.01, "{above}");
        assert!(phase_deg(2.0, 30e-6, 20e3).unwrap() < 0.0);
        assert_eq!(
            (phase_deg(2.0, 30e-6, 0.0), resonance_hz(0.0)),
            (None, None)
        );
        assert_eq!(resonance_hz(-1e-6), None);
    }
}
