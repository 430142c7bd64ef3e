//! What the paper publishes of its EKF: Tables 1 and 2.

use super::{Errors, F_SW_HZ, SNR_DB};

/// MRE of the paper's EKF in percent, (R, L), a row a frequency of [`F_SW_HZ`], a column an SNR of
/// [`SNR_DB`].
const EKF_PCT: [[(f64, f64); 4]; 4] = [
    [(3.11, 2.42), (2.87, 2.68), (2.85, 2.70), (11.24, 4.28)],
    [(4.04, 2.68), (4.02, 3.06), (4.01, 3.08), (8.98, 3.42)],
    [(4.62, 2.81), (4.54, 3.39), (4.54, 3.40), (6.05, 4.16)],
    [(5.54, 2.82), (5.62, 3.49), (5.62, 3.49), (6.31, 4.12)],
];

/// The paper's figure for its EKF; `None` for an operating point that the paper does not have.
pub fn ekf(f_sw_hz: f64, snr_db: Option<f64>) -> Option<Errors> {
    let row = F_SW_HZ.iter().position(|f| *f == f_sw_hz)?;
    let column = SNR_DB.iter().position(|s| *s == snr_db)?;
    let (r_pct, l_pct) = EKF_PCT[row][column];
    Some(Errors { r_pct, l_pct })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_read_by_row_and_column() {
        let at = |f, snr| ekf(f, snr).map(|e| (e.r_pct, e.l_pct));
        assert_eq!(at(50e3, Some(30.0)), Some((8.98, 3.42)));
        assert_eq!(at(70e3, None), Some((5.54, 2.82)));
        assert_eq!(at(55e3, None), None);
    }
}
