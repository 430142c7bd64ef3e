//! The paper's results for its PINN: Tables 1 to 3. Those of its EKF are in
//! [`crate::estimators::published`].

use crate::estimators::{F_SW_HZ, SNR_DB};

/// Errors of one operating point in percent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedErrors {
    /// Mean relative errors of R and L in percent (Tables 1 and 2).
    pub mre_pct: (f64, f64),
    /// Normalised mean squared errors of v and i in percent (Table 3; without noise the text's about 0.01 and
    /// 0.02).
    pub nmse_pct: (f64, f64),
}

/// (MRE_R, MRE_L, NMSE_v, NMSE_i), a row per frequency of [`F_SW_HZ`], a column per SNR of [`SNR_DB`].
const PINN_PCT: [[(f64, f64, f64, f64); 4]; 4] = [
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

/// The paper's figures for its PINN; `None` for an operating point that the paper does not have.
pub fn pinn(f_sw_hz: f64, snr_db: Option<f64>) -> Option<PublishedErrors> {
    let row = F_SW_HZ.iter().position(|f| *f == f_sw_hz)?;
    let column = SNR_DB.iter().position(|s| *s == snr_db)?;
    let (r, l, v, i) = PINN_PCT[row][column];
    Some(PublishedErrors {
        mre_pct: (r, l),
        nmse_pct: (v, i),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_read_by_row_and_column() {
        let at = pinn(60e3, Some(50.0)).expect("in Tables 2 and 3");
        assert_eq!((at.mre_pct, at.nmse_pct), ((2.39, 1.99), (0.40, 0.05)));
        assert_eq!(pinn(45e3, None).map(|p| p.mre_pct), Some((1.68, 1.81)));
        assert_eq!(pinn(45e3, Some(40.0)), None);
    }
}
