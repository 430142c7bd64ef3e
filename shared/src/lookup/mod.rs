//! The RL lookup: R and L of the load over switching frequency and current amplitude.
//!
//! The host builds it from identified windows, the firmware interpolates in it. Eight frequencies
//! by seventeen currents of u16, both axes logarithmic ([`grid`]); 544 bytes of cells and a bit per
//! cell that says whether it rests on observations. The lookup is advice: the firmware checks it
//! ([`blob`]) before it activates it, and no protection threshold depends on it.

pub mod blob;
pub mod grid;
pub mod plausible;
pub mod prior;

use crate::units::{MicroOhm, PicoHenry};
use grid::{CELLS, CURRENTS, FREQUENCIES};

/// Ohm per code of a resistance cell: 16 ohm over 16 bit.
pub const OHM_PER_CODE: f64 = 16.0 / 65_536.0;

/// Henry per code of an inductance cell: 64 µH over 16 bit.
pub const HENRY_PER_CODE: f64 = 64e-6 / 65_536.0;

/// Bytes of the observed-cell bitmap.
pub const OBSERVED_BYTES: usize = CELLS.div_ceil(8);

/// Largest step from the active version to a new one: version 2³² − 1 would leave no
/// room for a later one.
pub const LOOKUP_VERSION_STEP: u32 = 1_000;

/// One lookup. Cells are indexed `[frequency][current]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RlLookup {
    /// Grows with every lookup that the host builds; 0 is the built-in prior.
    pub version: u32,
    /// Resistance, [`OHM_PER_CODE`] each.
    pub r: [[u16; CURRENTS]; FREQUENCIES],
    /// Inductance, [`HENRY_PER_CODE`] each.
    pub l: [[u16; CURRENTS]; FREQUENCIES],
    /// Bit `cell % 8` of byte `cell / 8` is set where the cell rests on observations: of itself, or of others
    /// from which it follows closely. The others hold the prior, or a prediction that is not to be relied on.
    pub observed: [u8; OBSERVED_BYTES],
}

impl RlLookup {
    /// R and L at a switching frequency and an amplitude of the current's fundamental, bilinear in
    /// the grid's coordinates and clamped to its edges.
    ///
    /// Integer arithmetic with one rounding: the worst deviation from an exact bilinear
    /// interpolation of the same cells is 1 µΩ / 1 pH plus what the 16-bit coordinates cost,
    /// below 0.01 % on any plausible lookup.
    pub fn interpolate(&self, f_sw_hz: u32, i_ma: u32) -> (MicroOhm, PicoHenry) {
        self.at_frequency(f_sw_hz).interpolate(i_ma)
    }

    /// The lookup at one switching frequency, for several currents.
    pub fn at_frequency(&self, f_sw_hz: u32) -> AtFrequency<'_> {
        let (row, weight) = grid::split(grid::frequency_coordinate(f_sw_hz), FREQUENCIES);
        AtFrequency {
            lookup: self,
            row,
            weight,
        }
    }

    /// R of each cell, [frequency][current], in ohm.
    pub fn r_ohm(&self) -> [[f64; CURRENTS]; FREQUENCIES] {
        self.r
            .map(|row| row.map(|code| f64::from(code) * OHM_PER_CODE))
    }

    /// L of each cell, [frequency][current], in henry.
    pub fn l_h(&self) -> [[f64; CURRENTS]; FREQUENCIES] {
        self.l
            .map(|row| row.map(|code| f64::from(code) * HENRY_PER_CODE))
    }

    /// Returns `true` if the cell rests on observations.
    pub fn is_observed(&self, frequency: usize, current: usize) -> bool {
        let cell = frequency * CURRENTS + current;
        self.observed
            .get(cell / 8)
            .is_some_and(|byte| byte & (1 << (cell % 8)) != 0)
    }

    /// Returns `true` if the cell nearest to a switching frequency and a current's amplitude rests on
    /// observations.
    pub fn is_observed_at(&self, f_sw_hz: u32, i_ma: u32) -> bool {
        let nearest = |coordinate: u64| ((coordinate + grid::ONE / 2) >> 16) as usize;
        self.is_observed(
            nearest(grid::frequency_coordinate(f_sw_hz)),
            nearest(grid::current_coordinate(i_ma)),
        )
    }

    /// Marks a cell as observed; cells outside the grid are ignored.
    pub fn mark_observed(&mut self, frequency: usize, current: usize) {
        let cell = frequency * CURRENTS + current;
        if let Some(byte) = self.observed.get_mut(cell / 8) {
            *byte |= 1 << (cell % 8);
        }
    }

    /// Number of observed cells, of [`CELLS`].
    pub fn observed_cells(&self) -> u32 {
        self.observed.iter().map(|b| b.count_ones()).sum()
    }
}

/// A lookup at one switching frequency.
#[derive(Clone, Copy, Debug)]
pub struct AtFrequency<'a> {
    lookup: &'a RlLookup,
    row: usize,
    /// Weight of the row above, in 16-bit fixed point.
    weight: u64,
}

impl AtFrequency<'_> {
    /// Same as [`RlLookup::interpolate`].
    pub fn interpolate(&self, i_ma: u32) -> (MicroOhm, PicoHenry) {
        let (kf, wf) = (self.row, self.weight);
        let (ki, wi) = grid::split(grid::current_coordinate(i_ma), CURRENTS);
        let blend = |cells: &[[u16; CURRENTS]; FREQUENCIES]| -> u64 {
            let row = |k: usize| {
                u64::from(cells[k][ki]) * (grid::ONE - wi) + u64::from(cells[k][ki + 1]) * wi
            };
            row(kf) * (grid::ONE - wf) + row(kf + 1) * wf
        };
        // Cells times two 16-bit weights: 48 bit; the units' factors are 15625/64 µΩ and
        // 15625/16 pH per code, 14 bit more.
        let scale =
            |q32: u64, shift: u32| ((q32 * 15_625 + (1 << (31 + shift))) >> (32 + shift)) as i32;
        (
            MicroOhm(scale(blend(&self.lookup.r), 6)),
            PicoHenry(scale(blend(&self.lookup.l), 4)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The oracle: the same cells, interpolated in f64 with libm's logarithm.
    fn oracle(lookup: &RlLookup, f_hz: f64, i_a: f64) -> (f64, f64) {
        let uf = (7.0 * (f_hz / 30e3).ln() / (80.0f64 / 30.0).ln()).clamp(0.0, 7.0);
        let ui = (16.0 * (1.0 + i_a / 5.0).ln() / 17f64.ln()).clamp(0.0, 16.0);
        let (kf, ki) = ((uf as usize).min(6), (ui as usize).min(15));
        let (wf, wi) = (uf - kf as f64, ui - ki as f64);
        let blend = |c: &[[u16; CURRENTS]; FREQUENCIES]| {
            let row = |k: usize| f64::from(c[k][ki]) * (1.0 - wi) + f64::from(c[k][ki + 1]) * wi;
            row(kf) * (1.0 - wf) + row(kf + 1) * wf
        };
        (
            blend(&lookup.r) * OHM_PER_CODE,
            blend(&lookup.l) * HENRY_PER_CODE,
        )
    }

    #[test]
    fn fixed_point_follows_the_f64_oracle() {
        let lookup = prior::prior();
        for f_hz in (20_000..100_000).step_by(977) {
            for i_ma in (0..100_000).step_by(613) {
                let (r, l) = lookup.interpolate(f_hz, i_ma);
                let (r0, l0) = oracle(&lookup, f64::from(f_hz), f64::from(i_ma) * 1e-3);
                assert!(
                    (r.ohm() / r0 - 1.0).abs() < 1e-4,
                    "R at {f_hz} Hz, {i_ma} mA"
                );
                assert!(
                    (l.henry() / l0 - 1.0).abs() < 1e-4,
                    "L at {f_hz} Hz, {i_ma} mA"
                );
            }
        }
    }

    #[test]
    fn knots_give_their_cells() {
        let lookup = prior::prior();
        for kf in 0..FREQUENCIES {
            for ki in 0..CURRENTS {
                let (r, _) = lookup.interpolate(
                    grid::frequency_hz(kf).round() as u32,
                    (grid::current_a(ki) * 1e3).round() as u32,
                );
                let cell = f64::from(lookup.r[kf][ki]) * OHM_PER_CODE;
                assert!((r.ohm() / cell - 1.0).abs() < 1e-4, "cell {kf},{ki}");
            }
        }
    }

    #[test]
    fn observed_bits_are_one_per_cell() {
        let mut lookup = prior::prior();
        lookup.mark_observed(7, 16);
        lookup.mark_observed(0, 0);
        lookup.mark_observed(9, 0);
        assert!(lookup.is_observed(7, 16) && lookup.is_observed(0, 0));
        assert!(!lookup.is_observed(7, 15));
        assert!(lookup.is_observed_at(77_000, 75_000) && lookup.is_observed_at(31_000, 300));
        assert!(!lookup.is_observed_at(70_000, 80_000) && !lookup.is_observed_at(80_000, 66_000));
        assert_eq!(lookup.observed_cells(), 2);
    }
}
