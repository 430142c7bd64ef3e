//! A search for a frequency: the half-cycle and the request that it starts from, and what the measured power says.

use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::wire::messages::Limit;

use crate::control::bus_ripple::ripple_dv;
use crate::control::power::bounds::Bounds;
use crate::estimate::tank::{Tank, resonance_capacitor_mohm};
use crate::limits::{
    DEAD_BAND_PERCENT, PLANNED_BUS_DV, RESONANCE_MARGIN_PERCENT, STEP_DOWN_HZ, STEP_UP_HZ,
    TAUGHT_STEP_DOWN_HZ,
};
use crate::sampling::half_cycle::HalfCycle;

/// The smallest step for a measured error, in hertz: above resonance P ∝ f^−2 to f^−6, so a
/// sixth of the relative error never overshoots.
pub(super) fn trim_hz(f_sw_hz: u32, error_mw: u64, asked_mw: u64) -> u32 {
    let trim = u64::from(f_sw_hz) * error_mw / (6 * asked_mw.max(1));
    trim.min(u64::from(TAUGHT_STEP_DOWN_HZ)) as u32
}

/// Ripple of the bus that is more than the noise of its codes, behind poles that leave a twelfth of 80 kHz.
const RIPPLE_SEEN_DV: u64 = 50;

/// The largest step, in smallest ones: half of the relative error, for P ∝ f^−2. What the lookup
/// solves for counts between the two.
const MAX_OF_TRIM: u32 = 3;

/// A frequency being searched for a half-cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    /// The half-cycle that is over.
    pub summary: HalfCycle,
    /// Requested power, in milliwatt.
    pub asked_mw: u64,
    /// Bounds of the frequency.
    pub bounds: Bounds,
    /// Between these two lies the frequency, in hertz; `None` until the factor is learnt.
    pub bracket_hz: Option<(u32, u32)>,
    /// Ripple of a small link, in decivolt; 0 with a larger one.
    pub ripple_dv: u16,
    /// Limit that forbade a lower frequency.
    pub refused: Limit,
}

impl Search {
    /// The half-cycle's frequency, within the rated range, in hertz.
    pub fn now_hz(&self) -> u32 {
        self.summary.f_sw_hz.clamp(F_SW_MIN_HZ, F_SW_MAX_HZ)
    }

    /// Measured less requested power, in milliwatt.
    fn error_mw(&self) -> i64 {
        i64::from(self.summary.power_mw) - self.asked_mw as i64
    }

    fn is_within_dead_band(&self) -> bool {
        self.error_mw().unsigned_abs() * 100 <= self.asked_mw * u64::from(DEAD_BAND_PERCENT)
    }

    /// Lowest and highest frequency by the measured power; both alike where it alone decides.
    pub fn by_measurement(&self, step_down_hz: u32) -> (u32, u32) {
        let (summary, asked_mw) = (&self.summary, self.asked_mw);
        let now = self.now_hz();
        let measured = Tank::new(now, summary.crest.r, summary.crest.l);
        let error = self.error_mw();
        let trim = trim_hz(now, error.unsigned_abs(), asked_mw);
        let most = MAX_OF_TRIM * trim;
        if summary.crest.i_ma > 0 && !measured.is_above_resonance(RESONANCE_MARGIN_PERCENT / 2) {
            // The load is not the lookup's: leave resonance first.
            (now + STEP_UP_HZ, now + STEP_UP_HZ)
        } else if self.is_within_dead_band() {
            (now, now)
        } else if error > 0 {
            (now + trim.min(STEP_UP_HZ), now + most.min(STEP_UP_HZ))
        } else if measured.is_above_resonance(RESONANCE_MARGIN_PERCENT) {
            let least = trim.min(STEP_DOWN_HZ).min(step_down_hz);
            (now - most.min(step_down_hz), now - least)
        } else {
            // More power lies below the margin.
            (now, now)
        }
    }

    /// Returns `true` if the bus is too high for more power.
    pub fn is_bus_full(&self) -> bool {
        self.summary.bus_peak_dv >= PLANNED_BUS_DV
    }

    /// Limit that holds the power at a frequency that was found.
    pub fn held_by(&self, f_sw_hz: u32) -> Limit {
        if self.is_within_dead_band() {
            Limit::None
        } else if self.refused != Limit::None {
            self.refused
        } else if self.error_mw() < 0 && f_sw_hz <= F_SW_MIN_HZ + grid_step_hz(F_SW_MIN_HZ) {
            Limit::Frequency
        } else {
            Limit::None
        }
    }
}

/// Amplitude of the bus's ripple, in decivolt, if it shows less than 2.5 C_r in the link; 0 otherwise. The line's filter then
/// resonates with it near the switching frequency, and a lookup knows nothing of that.
pub(super) fn small_link_ripple_dv(summary: &HalfCycle) -> u16 {
    let crest = &summary.crest;
    let ripple = ripple_dv(&crest.bus, summary.f_sw_hz);
    let ripple_dv = u64::from(ripple.norm_squared().isqrt() as u32);
    // Half of the coil's current is the bus's: X = 2 · ripple / current, of the link's capacitance.
    let link_mohm = 2 * ripple_dv * 100_000 / u64::from(crest.i_ma.max(1));
    let capacitor_mohm = resonance_capacitor_mohm(summary.f_sw_hz) as u64;
    if ripple_dv >= RIPPLE_SEEN_DV && link_mohm * 5 > capacitor_mohm * 2 {
        ripple_dv.min(u64::from(u16::MAX)) as u16
    } else {
        0
    }
}

/// Distance of two frequencies of the grid, f²/22.3 MHz, in hertz.
pub(super) fn grid_step_hz(f_sw_hz: u32) -> u32 {
    (f_sw_hz >> 10) * (f_sw_hz >> 10) / 21
}
