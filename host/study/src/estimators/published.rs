//! The paper's results for its EKF: Tables 1 to 3.

use super::{F_SW_HZ, RlErrors, SNR_DB};

/// MRE of the paper's EKF in percent, (R, L), a row a frequency of [`F_SW_HZ`], a column an SNR of
/// [`SNR_DB`].
const EKF_PCT: [[(f64, f64); 4]; 4] = [
    [(3.11, 2.42), (2.87, 2.68), (2.85, 2.70), (11.24, 4.28)],
    [(4.04, 2.68), (4.02, 3.06), (4.01, 3.08), (8.98, 3.42)],
    [(4.62, 2.81), (4.54, 3.39), (4.54, 3.40), (6.05, 4.16)],
    [(5.54, 2.82), (5.62, 3.49), (5.62, 3.49), (6.31, 4.12)],
];

/// NMSE of v and i of the paper's EKF in percent at 70, 50 and 30 dB (Table 3), a row a frequency; without
/// noise the text says 0.00 for both.
const EKF_NMSE_PCT: [[(f64, f64); 4]; 4] = [
    [(0.0, 0.0), (0.44, 0.0), (0.44, 0.01), (0.54, 0.02)],
    [(0.0, 0.0), (0.64, 0.01), (0.64, 0.01), (0.74, 0.02)],
    [(0.0, 0.0), (1.06, 0.01), (1.06, 0.01), (1.16, 0.03)],
    [(0.0, 0.0), (1.48, 0.02), (1.48, 0.02), (1.58, 0.04)],
];

/// The paper's figure for its EKF; `None` for an operating point that the paper does not have.
pub fn ekf(f_sw_hz: f64, snr_db: Option<f64>) -> Option<RlErrors> {
    let (row, column) = place(f_sw_hz, snr_db)?;
    let (r_pct, l_pct) = EKF_PCT[row][column];
    Some(RlErrors { r_pct, l_pct })
}

/// NMSE of v and i of the paper's EKF in percent; `None` for an operating point that the paper does not have.
pub fn ekf_nmse(f_sw_hz: f64, snr_db: Option<f64>) -> Option<(f64, f64)> {
    let (row, column) = place(f_sw_hz, snr_db)?;
    Some(EKF_NMSE_PCT[row][column])
}

fn place(f_sw_hz: f64, snr_db: Option<f64>) -> Option<(usize, usize)> {
    let row = F_SW_HZ.iter().position(|f| *f == f_sw_hz)?;
    let column = SNR_DB.iter().position(|s| *s == snr_db)?;
    Some((row, column))
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
        assert_eq!(ekf_nmse(60e3, Some(30.0)), Some((1.16, 0.03)));
    }
}
