//! Reference loads of a calibration.

use std::fmt;

/// Load with known properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReferenceLoad {
    /// Coil without a pot: its R is small and grows no faster than √f, its L is constant.
    NoPot {
        /// R in ohm at the lowest frequency; `None` if unknown.
        r_ohm: Option<f64>,
        /// L in henry; `None` if unknown.
        l_h: Option<f64>,
    },
    /// Load whose R, L or both are known at the switching frequency.
    Load {
        /// R in ohm; `None` if unknown.
        r_ohm: Option<f64>,
        /// L in henry; `None` if unknown.
        l_h: Option<f64>,
    },
}

impl fmt::Display for ReferenceLoad {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (words, r_ohm, l_h) = match *self {
            Self::NoPot { r_ohm, l_h } => ("no-pot", r_ohm, l_h),
            Self::Load { r_ohm, l_h } => ("", r_ohm, l_h),
        };
        let r = r_ohm.map(|r| format!("r={r}"));
        let l = l_h.map(|l| format!("l={:.4}u", l * 1e6));
        let name = (!words.is_empty()).then(|| words.to_owned());
        let all: Vec<String> = [name, r, l].into_iter().flatten().collect();
        f.write_str(&all.join(","))
    }
}
