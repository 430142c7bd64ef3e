//! Limits that several parts of the gate compare with.

use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE, plausible};

/// Tolerable mean error of R and of L in percent; a larger one is always reported.
pub const TOLERABLE_PCT: [f64; 2] = [1.0, 0.7];

/// Standard deviations of a correction that must lie within [`TOLERABLE_PCT`].
pub const TOLERABLE_SIGMAS: f64 = 2.0;

/// Share of [`TOLERABLE_PCT`] from which a difference is a warning: the rest is left for the reference's own error.
pub const WARNING_SHARE: f64 = 0.7;

/// Share of [`TOLERABLE_PCT`] above which a tone is mentioned.
pub const INFO_SHARE: f64 = 0.2;

/// Largest mean standard deviation of R and of L in percent of the value.
pub const MAX_SIGMA_PCT: f64 = 3.0;

/// Lowest and highest R in ohm, and L in henry, that a hob's lookup can hold.
pub fn plausible_ranges() -> [(f64, f64); 2] {
    let of = |codes: &core::ops::RangeInclusive<u16>, unit: f64| {
        (
            f64::from(*codes.start()) * unit,
            f64::from(*codes.end()) * unit,
        )
    };
    [
        of(&plausible::R_CODES, OHM_PER_CODE),
        of(&plausible::L_CODES, HENRY_PER_CODE),
    ]
}
