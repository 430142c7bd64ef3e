//! Switching frequencies below the search, whose harmonic near the resonance is the strongest line of current and voltage.

use ihd_signal::Capture;

use super::carrier::CarrierPiece;
use super::finding::{Finding, MIN_SUBHARMONIC_PCT};
use super::track;

/// Orders that a hob far below its resonance lifts above the fundamental.
const ORDERS: [u32; 4] = [2, 3, 4, 5];

/// Periods of the harmonic in a frame: whole ones of each order.
const FRAME_PERIODS: f64 = 60.0;

/// Longest part that is looked at, in seconds: two half-cycles.
const LOOK_S: f64 = 20e-3;

/// Finding on the first piece whose frequency is a harmonic of a line in the current.
pub(super) fn find(capture: &Capture, pieces: &[CarrierPiece]) -> Option<Finding> {
    pieces.iter().find_map(|piece| of_piece(capture, piece))
}

fn of_piece(capture: &Capture, piece: &CarrierPiece) -> Option<Finding> {
    let samples = piece.run.samples.clone();
    let spare = samples
        .len()
        .saturating_sub((LOOK_S / piece.run.dt_s) as usize)
        / 2;
    let run = piece.run.part(samples.start + spare..samples.end - spare);
    let frame = (FRAME_PERIODS / (piece.f_hz * run.dt_s)).round() as usize;
    let rms = |f_hz: f64| {
        let i_a = track::current(capture, &run, f_hz, (frame, frame / 2)).i_a;
        let sum: f64 = i_a.iter().map(|i| i.norm_sqr()).sum();
        (sum / i_a.len().max(1) as f64).sqrt()
    };
    let own = rms(piece.f_hz);
    let of = |order: u32| (order, 100.0 * rms(piece.f_hz / f64::from(order)) / own);
    let all = ORDERS
        .map(of)
        .into_iter()
        .filter(|(_, share_pct)| *share_pct > MIN_SUBHARMONIC_PCT);
    let (order, share_pct) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Finding::HarmonicTaken {
        f_hz: piece.f_hz,
        order,
        share_pct,
    })
}
