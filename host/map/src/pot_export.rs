//! Export of a pot from this hob's map to the library of other hobs.

use nalgebra::DVector;

use crate::library::{ExportedFit, MeasuredRange, PotEntry, Provenance, shape_places};
use crate::{PotMap, PotModel};

/// Least number of frequencies at which a pot must have been measured; the next constant is the least ratio of the highest to
/// the lowest.
const MIN_CURVES: u32 = 3;
const MIN_RATIO: f64 = 1.19;

impl PotMap {
    /// Creates the library entry of a pot that this hob knows well by itself: measured at three frequencies or more, the highest a
    /// quarter of an octave above the lowest. Knowledge from the library itself is not exported. `None` if the pot is known less
    /// well, or `by` holds no valid names.
    pub fn entry(&self, by: Provenance) -> Option<PotEntry> {
        let posterior = self.own_posterior()?;
        let seen = self.measured_range()?;
        if seen.curves < MIN_CURVES || seen.f_sw_hz[1] < MIN_RATIO * seen.f_sw_hz[0] {
            return None;
        }
        let factor = posterior.factor_of_numbers()?;
        let (model, places) = (posterior.fit().model(), shape_places());
        let (map, _) = posterior.joint(&places, 0.0);
        let physics = physics(&model, &places);
        let fit = ExportedFit {
            model,
            factor,
            misfit: posterior.misfit(),
            beside: map - physics,
            seen,
        };
        PotEntry::from_fit(&fit, by)
    }

    fn measured_range(&self) -> Option<MeasuredRange> {
        let span = |all: &mut dyn Iterator<Item = f64>| {
            let none = [f64::INFINITY, f64::NEG_INFINITY];
            let [low, high] = all.fold(none, |[a, b], x| [a.min(x), b.max(x)]);
            (low <= high).then_some([low, high])
        };
        let currents = self.curves().iter().flat_map(|c| c.means().map(|m| m.i_a));
        Some(MeasuredRange {
            f_sw_hz: span(&mut self.curves().iter().map(|c| c.f_sw_hz))?,
            i_a: span(&mut { currents })?,
            curves: self.curves().len() as u32,
            windows: self
                .curves()
                .iter()
                .map(|c| c.windows)
                .fold(0, u32::saturating_add),
        })
    }
}

/// ln R and ln L of a model at places: R of all, then L of all.
fn physics(model: &PotModel, places: &[(f64, f64)]) -> DVector<f64> {
    let load = |k: usize| {
        let (f_hz, i_a) = places[k % places.len()];
        model.impedance(f_hz, i_a)
    };
    DVector::from_fn(2 * places.len(), |k, _| match k < places.len() {
        true => load(k).r_ohm.ln(),
        false => load(k).l_h.ln(),
    })
}
