//! The paper's results for its EKF and its PINN: Tables 1 to 3.

use super::{F_SW_HZ, RlErrors, SNR_DB};

/// Errors of one operating point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedErrors {
    /// Mean relative errors of R and L (Tables 1 and 2).
    pub mre: RlErrors,
    /// Normalised mean squared errors of v and i in percent (Table 3; without noise the text's 0.00 of the EKF, and about 0.01 and
    /// 0.02 of the PINN).
    pub nmse_pct: (f64, f64),
}

/// (MRE_R, MRE_L, NMSE_v, NMSE_i) in percent, a row per frequency of [`F_SW_HZ`], a column per SNR of [`SNR_DB`].
type Table = [[(f64, f64, f64, f64); 4]; 4];

const EKF_PCT: Table = [
    [
        (3.11, 2.42, 0.0, 0.0),
        (2.87, 2.68, 0.44, 0.0),
        (2.85, 2.70, 0.44, 0.01),
        (11.24, 4.28, 0.54, 0.02),
    ],
    [
        (4.04, 2.68, 0.0, 0.0),
        (4.02, 3.06, 0.64, 0.01),
        (4.01, 3.08, 0.64, 0.01),
        (8.98, 3.42, 0.74, 0.02),
    ],
    [
        (4.62, 2.81, 0.0, 0.0),
        (4.54, 3.39, 1.06, 0.01),
        (4.54, 3.40, 1.06, 0.01),
        (6.05, 4.16, 1.16, 0.03),
    ],
    [
        (5.54, 2.82, 0.0, 0.0),
        (5.62, 3.49, 1.48, 0.02),
        (5.62, 3.49, 1.48, 0.02),
        (6.31, 4.12, 1.58, 0.04),
    ],
];

const PINN_PCT: Table = [
    [
        (1.68, 1.81, 0.01, 0.02),
        (2.30, 2.57, 0.17, 0.03),
        (1.63, 1.90, 0.18, 0.02),
        (1.46, 1.89, 0.19, 0.02),
    ],
    [
        (1.12, 1.71, 0.01, 0.02),
        (2.37, 2.39, 0.27, 0.03),
        (1.58, 1.92, 0.26, 0.03),
        (2.70, 2.03, 0.26, 0.04),
    ],
    [
        (1.66, 2.14, 0.01, 0.02),
        (1.53, 2.01, 0.44, 0.04),
        (2.39, 1.99, 0.40, 0.05),
        (2.26, 1.82, 0.42, 0.05),
    ],
    [
        (1.68, 2.03, 0.01, 0.02),
        (1.98, 2.19, 0.66, 0.06),
        (1.54, 1.98, 0.62, 0.05),
        (2.20, 1.83, 0.58, 0.05),
    ],
];

/// The paper's figures for its EKF; `None` for an operating point that the paper does not have.
pub fn ekf(f_sw_hz: f64, snr_db: Option<f64>) -> Option<PublishedErrors> {
    read(&EKF_PCT, f_sw_hz, snr_db)
}

/// The paper's figures for its PINN; `None` for an operating point that the paper does not have.
pub fn pinn(f_sw_hz: f64, snr_db: Option<f64>) -> Option<PublishedErrors> {
    read(&PINN_PCT, f_sw_hz, snr_db)
}

fn read(table: &Table, f_sw_hz: f64, snr_db: Option<f64>) -> Option<PublishedErrors> {
    let row = F_SW_HZ.iter().position(|f| *f == f_sw_hz)?;
    let column = SNR_DB.iter().position(|s| *s == snr_db)?;
    let (r_pct, l_pct, v_pct, i_pct) = table[row][column];
    Some(PublishedErrors {
        mre: RlErrors { r_pct, l_pct },
        nmse_pct: (v_pct, i_pct),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_read_by_row_and_column() {
        let at = |table: fn(f64, Option<f64>) -> Option<PublishedErrors>, f_sw_hz, snr_db| {
            let of = table(f_sw_hz, snr_db)?;
            Some((of.mre.r_pct, of.mre.l_pct, of.nmse_pct))
        };
        assert_eq!(at(ekf, 50e3, Some(30.0)), Some((8.98, 3.42, (0.74, 0.02))));
        assert_eq!(at(ekf, 70e3, None), Some((5.54, 2.82, (0.0, 0.0))));
        assert_eq!(at(pinn, 60e3, Some(50.0)), Some((2.39, 1.99, (0.40, 0.05))));
        assert_eq!(at(pinn, 55e3, None), None);
        assert_eq!(at(pinn, 45e3, Some(40.0)), None);
    }
}
