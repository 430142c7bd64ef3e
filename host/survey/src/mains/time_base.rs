//! Time bases that turn the mains into one that no grid has.

use super::super::grid::RANGE_HZ;
use super::fit::{Fit, Law, NOMINAL_HZ, PieceEnvelope, Search, fit};
use super::{Coverage, FREE_HALF_CYCLES, MAX_UNEXPLAINED_SHARE};

/// Largest difference in hertz of a grid from 50 or 60.
const GRID_HZ: f64 = 1.5;

/// Frequencies beyond [`RANGE_HZ`] that are searched, in hertz: rates wrong by up to three.
const FAR_HZ: [(f64, f64); 2] = [(20.0, RANGE_HZ.0 - 1.0), (RANGE_HZ.1 + 2.0, 150.0)];

/// Those of half and twice a grid's, between which pauses leave a choice.
const PAUSED_HZ: [f64; 4] = [25.0, 30.0, 100.0, 120.0];

/// Largest unexplained variance of a far frequency, and relative to that of [`RANGE_HZ`].
const MAX_UNEXPLAINED: f64 = 0.02;
const FAR_BETTER: f64 = 0.1;

/// Largest unexplained variance relative to that of a grid's frequency.
const BETTER: f64 = 0.3;

/// Frequency in hertz that the envelope shows, if no grid has it and a grid's explains it by far less; `usual` is the best of
/// [`RANGE_HZ`].
pub(super) fn no_grids_hz(
    envelopes: &[PieceEnvelope],
    usual: Option<Fit>,
    coverage: &Coverage,
) -> Option<f64> {
    let of_usual = usual.map_or(1.0, |fit| fit.unexplained);
    let most = MAX_UNEXPLAINED.min(FAR_BETTER * of_usual);
    let fit_beyond_grids =
        (of_usual > MAX_UNEXPLAINED_SHARE).then(|| fit_beyond_grids(envelopes, coverage));
    if let Some(fit_beyond_grids) = fit_beyond_grids
        .flatten()
        .filter(|fit_beyond_grids| fit_beyond_grids.unexplained < most)
    {
        return Some(fit_beyond_grids.hz);
    }
    let usual = usual.filter(|fit| NOMINAL_HZ.iter().all(|hz| (fit.hz - hz).abs() > GRID_HZ))?;
    let limits = NOMINAL_HZ
        .iter()
        .flat_map(|hz| [hz - GRID_HZ, hz + GRID_HZ]);
    let of_grid = limits
        .filter_map(|hz| fit(envelopes, Search::At(hz, Law::Held)))
        .map(|fit| fit.unexplained)
        .fold(1.0, f64::min);
    (usual.unexplained < BETTER * of_grid).then_some(usual.hz)
}

/// Best fit of a frequency beyond [`RANGE_HZ`].
fn fit_beyond_grids(envelopes: &[PieceEnvelope], coverage: &Coverage) -> Option<Fit> {
    // Shorter captures cannot separate a constant from a lower frequency.
    let least_hz = 0.5 * FREE_HALF_CYCLES / coverage.seen_s;
    let searches: Vec<Search> = if coverage.is_paused {
        let of = PAUSED_HZ.iter().filter(|hz| **hz >= least_hz);
        of.map(|hz| Search::At(*hz, Law::Held)).collect()
    } else {
        let of = FAR_HZ.iter().filter(|(_, to)| *to > least_hz);
        of.map(|(from, to)| Search::Free(from.max(least_hz), *to))
            .collect()
    };
    let fits = searches.into_iter().filter_map(|s| fit(envelopes, s));
    fits.min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))
}
