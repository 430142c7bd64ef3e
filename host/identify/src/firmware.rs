//! The firmware's own chain: the capture behind the board's current transformer, resampled to the ADC's grid, then demodulator and
//! fixed-point filter as the board runs them, bit for bit.

use std::f64::consts::TAU;
use std::time::Instant;

use ihd_firmware::estimate::ekf::{Ekf, Noise};
use ihd_firmware::sense::correlation::correlate;
use ihd_firmware::sense::demodulator::Demodulator;
use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, Scales};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_signal::resample::{AdcGrid, adc_pairs};
use ihd_signal::{Segment, TimeBase, current_transformer};

use super::{Estimate, IdentifyError, IdentifyOptions, Method};

/// Runs the firmware's chain over the segment. It starts from the load that the built-in lookup
/// expects without current.
///
/// # Errors
/// [`IdentifyError::Unfit`] for a switching frequency outside the hob's ratings,
/// [`ihd_signal::SegmentError::TooShort`] if the demodulator does not fill.
pub fn identify(segment: &Segment, settings: &IdentifyOptions) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let f_sw_hz = segment.f_sw_hz.round() as u32;
    if !(F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&f_sw_hz) {
        return Err(IdentifyError::Unfit {
            method: Method::Firmware,
            why: format!(
                "{f_sw_hz} Hz is outside the hob's {F_SW_MIN_HZ} to {F_SW_MAX_HZ} Hz: use another method"
            ),
        });
    }
    let time = TimeBase::Even {
        t0_s: segment.t0_s,
        dt_s: segment.dt_s,
    };
    let grid = AdcGrid {
        f_sw_hz: segment.f_sw_hz,
        t0_s: segment.t0_s,
    };
    let mut i_a = segment.i_a.to_vec();
    current_transformer::droop(&mut i_a, segment.dt_s, current_transformer::BOARD_TAU_S);
    let pairs = adc_pairs(&time, &segment.v_v[..], &i_a, grid, Scales::OF_THIS_BUILD);
    let (r, l) = start(settings, f_sw_hz);
    let omega = TAU * segment.f_sw_hz;
    let mut demod = Demodulator::new(f_sw_hz);
    let mut ekf = Ekf::new(f_sw_hz, r, l, Noise::TUNED);
    let block_s = ADC_LOCK_P as f64 * grid.dt_s();
    let mut estimate = Estimate::new(Method::Firmware, segment.f_sw_hz);
    let (mut saturated, mut at_bound) = (0u32, false);
    for (k, block) in pairs.as_chunks::<ADC_LOCK_P>().0.iter().enumerate() {
        let sums = correlate(block);
        saturated += u32::from(sums.saturated);
        let Some(phasors) = demod.push(&sums) else {
            continue;
        };
        ekf.step(&phasors);
        at_bound |= ekf.is_at_bound();
        let centre = k as f64 + 0.5 - f64::from(demod.delay_blocks());
        let t_s = segment.t0_s + centre * block_s - 0.5 * grid.dt_s();
        let r_l = (ekf.r().ohm(), ekf.l().henry());
        // The filter keeps one variance for R and X = ωL.
        let sigma = ekf.r_sigma().ohm();
        estimate.push(t_s, r_l, (sigma, sigma / omega));
    }
    if estimate.t_s.is_empty() {
        let needed = 3.0 * f64::from(2 * demod.delay_blocks() + 1);
        return Err(segment.too_short(needed).into());
    }
    if saturated > 0 {
        estimate.notes.push(format!(
            "{saturated} sample pairs beyond the ADC's {}",
            Scales::OF_THIS_BUILD
        ));
    }
    if at_bound {
        estimate
            .notes
            .push("the filter ran into a bound of R or L: this is no load of a hob".into());
    }
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}

fn start(settings: &IdentifyOptions, f_sw_hz: u32) -> (MicroOhm, PicoHenry) {
    let rounded = |x: f64| libm::round(x).clamp(0.0, f64::from(i32::MAX)) as i32;
    match settings.start {
        Some((r, l)) => (MicroOhm(rounded(r * 1e6)), PicoHenry(rounded(l * 1e12))),
        None => prior().interpolate(f_sw_hz, 0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bare coil of 0.1 Ω and 50 µH: without the transformer before it the firmware would take 4.4 mΩ off.
    #[test]
    fn the_transformer_that_the_firmware_corrects_is_there() {
        let (f_sw_hz, r_ohm, l_h, i_a) = (45e3, 0.1, 50e-6, 20.0);
        let (dt_s, omega) = (1.0 / (40.0 * f_sw_hz), TAU * f_sw_hz);
        let wave = |r: f64, x: f64| -> Vec<f64> {
            let at = |k: usize| (omega * dt_s * k as f64).sin_cos();
            let value = |(sin, cos): (f64, f64)| i_a * (r * sin + x * cos);
            (0..16_000).map(at).map(value).collect()
        };
        let segment = Segment {
            f_sw_hz,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s,
            v_v: wave(r_ohm, omega * l_h).into(),
            i_a: wave(1.0, 0.0).into(),
        };
        let estimate = identify(&segment, &IdentifyOptions::default()).unwrap();
        let last = estimate.r_ohm.last().unwrap();
        assert!((last / r_ohm - 1.0).abs() < 0.02, "{last}");
    }
}
