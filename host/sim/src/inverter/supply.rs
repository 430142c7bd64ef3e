//! Parts between the house's mains and the half-bridge.
//!
//! ```text
//!  e(t) ── line R, L ──┬── L1 ── rectifier ──┬────────┬── bridge
//!                      C1                    C2    bleeder, divider
//!  ────────────────────┴─────────────────────┴────────┴──
//! ```

use ihd_shared::board;

use super::{InverterError, in_range};
use crate::front_end::BUS_CHAIN_OHM;

/// Values of the parts between mains and bridge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupplyParts {
    /// Resistance of the line, in ohm.
    pub line_r_ohm: f64,
    /// Inductance of the line, in henry; 0: the line is a resistance, and C1 and L1 have no effect.
    pub line_l_h: f64,
    /// Capacitance C1 between the mains terminals, in farad.
    pub terminal_capacitance_f: f64,
    /// Leakage inductance of the common-mode choke L1, in henry: what it adds to the line behind C1.
    pub choke_l_h: f64,
    /// Voltage of the two conducting diodes, in volt.
    pub rectifier_v: f64,
    /// Resistance of the two conducting diodes, of fuse and choke, in ohm.
    pub rectifier_r_ohm: f64,
    /// Capacitance C2 of the DC link, in farad; 0: the bus is the rectified mains, whatever the other parts.
    pub link_capacitance_f: f64,
    /// Resistance across the DC link, bleeder and divider of its voltage side by side, in ohm; infinite for none.
    pub discharge_ohm: f64,
}

/// Resistance of line, fuse and rectifier in front of the capacitor of [`SupplyParts::stiff`], in ohm.
const STIFF_R_OHM: f64 = 0.2;

impl SupplyParts {
    /// No parts: the bus is the rectified mains, as in the paper.
    pub const NONE: Self = Self::stiff(0.0);

    /// Capacitor of the DC link, in farad, behind an ideal rectifier and a line of 0.2 ohm.
    pub const fn stiff(link_capacitance_f: f64) -> Self {
        Self {
            line_r_ohm: STIFF_R_OHM,
            line_l_h: 0.0,
            terminal_capacitance_f: 0.0,
            choke_l_h: 0.0,
            rectifier_v: 0.0,
            rectifier_r_ohm: 0.0,
            link_capacitance_f,
            discharge_ohm: f64::INFINITY,
        }
    }

    /// The parts of the board's file, behind its line.
    pub const SCHEMATIC: Self = Self {
        line_r_ohm: board::LINE_MOHM as f64 * 1e-3,
        line_l_h: board::LINE_UH as f64 * 1e-6,
        terminal_capacitance_f: board::TERMINAL_CAPACITANCE_NF as f64 * 1e-9,
        choke_l_h: board::CHOKE_LEAKAGE_UH as f64 * 1e-6,
        rectifier_v: board::RECTIFIER_MV as f64 * 1e-3,
        rectifier_r_ohm: board::RECTIFIER_MOHM as f64 * 1e-3,
        link_capacitance_f: board::LINK_CAPACITANCE_NF as f64 * 1e-9,
        discharge_ohm: 1.0 / (1.0 / board::BLEEDER_OHM as f64 + 1.0 / BUS_CHAIN_OHM),
    };

    /// Returns these parts with another capacitance of the DC link in farad and inductance of the line in henry, where given. Both
    /// are the schematic's parts if there were none.
    pub fn with(self, link_capacitance_f: Option<f64>, line_l_h: Option<f64>) -> Self {
        let given = link_capacitance_f.is_some() || line_l_h.is_some();
        let parts = match self == Self::NONE && given {
            true => Self::SCHEMATIC,
            false => self,
        };
        Self {
            link_capacitance_f: link_capacitance_f.unwrap_or(parts.link_capacitance_f),
            line_l_h: line_l_h.unwrap_or(parts.line_l_h),
            ..parts
        }
    }

    /// Checks all values; the error names the field.
    ///
    /// # Errors
    /// [`InverterError::OutOfRange`].
    pub fn check(&self) -> Result<(), InverterError> {
        let Self {
            line_r_ohm,
            line_l_h,
            terminal_capacitance_f,
            choke_l_h,
            ..
        } = *self;
        if self.link_capacitance_f != 0.0 {
            let allowed = "0, or 0.1 µF to 1 mF";
            in_range(
                "bus_capacitance_f",
                self.link_capacitance_f,
                1e-7,
                1e-3,
                allowed,
            )?;
        }
        in_range("line_r_ohm", line_r_ohm, 0.01, 10.0, "0.01 to 10 ohm")?;
        in_range("rectifier_v", self.rectifier_v, 0.0, 5.0, "0 to 5 V")?;
        in_range(
            "rectifier_r_ohm",
            self.rectifier_r_ohm,
            0.0,
            10.0,
            "0 to 10 ohm",
        )?;
        in_range(
            "discharge_ohm",
            self.discharge_ohm,
            1e3,
            f64::INFINITY,
            "1 kohm or more",
        )?;
        if line_l_h != 0.0 {
            // The fastest of the two resonant circuits has a period of a microsecond or more.
            in_range("line_l_h", line_l_h, 1e-6, 10e-3, "0, or 1 µH to 10 mH")?;
            in_range("choke_l_h", choke_l_h, 1e-6, 10e-3, "1 µH to 10 mH")?;
            let allowed = "50 nF to 10 µF";
            in_range(
                "terminal_capacitance_f",
                terminal_capacitance_f,
                50e-9,
                10e-6,
                allowed,
            )?;
        }
        Ok(())
    }
}
