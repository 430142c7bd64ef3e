//! The surrogate against the field model, over a mains half-cycle.

use super::prepared::surrogate_pot;
use super::run::record;
use super::settings::{CaptureSpec, LoadKind};
use crate::inverter::InverterError;

/// Smallest current amplitude that counts, in ampere.
const MIN_A: f64 = 2.0;

/// Mean relative deviations in percent over the second half-cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableDeviation {
    /// Deviation of R: the table at the field model's current, against the waveform's fundamental.
    pub r_pct: f64,
    /// Deviation of L: the table at the field model's current, against the waveform's fundamental.
    pub l_pct: f64,
    /// Deviation of the current amplitude, each model in its own circuit.
    pub i_pct: f64,
    /// Deviation of P/I_rms² from R of the fundamental, field model alone.
    pub power_r_pct: f64,
}

/// Runs both models with the same settings.
pub fn surrogate_against_field(settings: &CaptureSpec) -> Result<TableDeviation, InverterError> {
    let of_kind = |load| CaptureSpec {
        load,
        duration_s: 1.0 / settings.mains_hz,
        ..settings.clone()
    };
    let field = record(&of_kind(LoadKind::Field), |_| ())?;
    let surrogate = record(&of_kind(LoadKind::Surrogate), |_| ())?;
    let law = surrogate_pot(&settings.pot, settings.winding_r_ohm)?.at(settings.f_sw_hz);
    let from_s = 0.5 / settings.mains_hz;
    let pairs: Vec<_> = (field.truth.iter().zip(&surrogate.truth))
        .filter(|(f, _)| f.t_s > from_s && f.i_a > MIN_A)
        .collect();
    let mean = |value: &dyn Fn(usize) -> f64| {
        100.0 * (0..pairs.len()).map(|k| value(k).abs()).sum::<f64>() / pairs.len() as f64
    };
    let law_at = |k: usize| law.r_l(pairs[k].0.i_a);
    Ok(TableDeviation {
        r_pct: mean(&|k| law_at(k).0 / pairs[k].0.r_ohm[0] - 1.0),
        l_pct: mean(&|k| law_at(k).1 / pairs[k].0.l_h[0] - 1.0),
        i_pct: mean(&|k| pairs[k].1.i_a / pairs[k].0.i_a - 1.0),
        power_r_pct: mean(&|k| pairs[k].0.r_power_ohm / pairs[k].0.r_ohm[0] - 1.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reduced_model_is_close_to_the_field_in_operation() {
        let settings = CaptureSpec {
            f_sw_hz: 60e3,
            dt_s: 50e-9,
            ..CaptureSpec::default()
        };
        let d = surrogate_against_field(&settings).unwrap();
        println!("{d:?}");
        assert!(d.r_pct < 8.0 && d.l_pct < 2.0 && d.i_pct < 5.0, "{d:?}");
    }
}
