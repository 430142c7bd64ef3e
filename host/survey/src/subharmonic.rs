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
    let [second, third, fourth, fifth] = ORDERS.map(|order| piece.f_hz / f64::from(order));
    let f_hz = [piece.f_hz, second, third, fourth, fifth];
    let [own, of_orders @ ..] = track::rms_of_current(capture, &run, f_hz, (frame, frame / 2));
    let all = (ORDERS.into_iter().zip(of_orders))
        .map(|(order, rms)| (order, 100.0 * rms / own))
        .filter(|(_, share_pct)| *share_pct > MIN_SUBHARMONIC_PCT);
    let (order, share_pct) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Finding::HarmonicTaken {
        f_hz: piece.f_hz,
        order,
        share_pct,
    })
}
