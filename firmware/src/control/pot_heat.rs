//! Limit of what stands on the glass: the highest temperature that a pot's base may have, by what the glass's sensor shows of it.
//!
//! Base and glass, for an area of 1 m²: c dT_glass/dt = h (T_base − T_glass) − g (T_glass − T_room). The sensor follows the glass with
//! a lag τ, so that
//!
//! ```text
//! T_base = T_sensor + (c/h + τ) dT_sensor/dt + g/h (T_sensor − T_room)
//! ```
//!
//! but for what the lag changes within its own time. c is 8.1 kJ/m²K (4 mm of glass ceramic), g 43 W/m²K, τ 10 s. h is unknown: a flat base
//! has some 230 W/m²K. Half of it is assumed: c/h + τ = 80 s, g/h = 3/8. A flatter base is then taken for hotter than it is, the more the faster it
//! heats: an empty pan on a flat one is slowed from 172 °C on, and gets to 254 °C (docs/control.md). A base with less than half of that
//! conductance (feet, a mat) is taken for colder: the limits of [`super::temperature`] remain.
//!
//! Keeping warm needs no bound but the temperature itself, which changes slowly: T_base = T_sensor + g/h (T_sensor − T_room), with a
//! contact of .8 (g/h = .24). From half of a flat base's contact to one and a half the sensor differs by 7 °C at 70 °C.

use crate::limits::{
    KEEP_WARM_C, KEEP_WARM_LOSS_PERCENT, KEEP_WARM_W, KEEP_WARM_W_PER_K, LEVELS, POT_HOT_C,
    POT_LEAD_S, POT_LOSS_PERCENT, POT_TOO_HOT_C,
};
use ihd_shared::hob::RATED_POWER_W;

/// Time constant of the mean that the rate is taken against, in seconds.
const MEAN_S: i32 = 5;

/// Room temperature in °C: 10 K more are 4 K of the base.
const ROOM_C: i32 = 25;

/// One degree, of the numbers here.
const ONE_C: i32 = 1 << 8;

/// Readings that a sum takes: an hour without a second is none.
const READINGS_MAX: i32 = 4_096;

/// Highest temperature of a base by its glass, and what it takes from the power.
#[derive(Clone, Copy, Debug, Default)]
pub struct PotHeat {
    /// Milliseconds of this second.
    second_ms: u32,
    /// Sum of the readings of this second in 1/16 °C, and their number.
    readings: (i32, i32),
    /// Mean of the sensor over [`MEAN_S`]; `None` before its first reading.
    mean: Option<i32>,
    /// Highest temperature that the base may have with half of a flat one's contact.
    base: i32,
    /// Share of the rating that is taken away, in percent.
    taken_percent: i32,
}

impl PotHeat {
    /// Takes a reading of the glass's sensor in 1/16 °C; `None` if there is none, or it failed.
    pub fn take(&mut self, glass: Option<i32>) {
        let (sum, readings) = self.readings;
        match glass {
            Some(glass) if readings < READINGS_MAX => self.readings = (sum + glass, readings + 1),
            // A loose wire does not hide a rate: what was read before stands.
            Some(_) | None => {}
        }
    }

    /// Passes time, in milliseconds, and counts each second that is over.
    pub fn pass_time(&mut self, elapsed_ms: u32) {
        self.second_ms = self.second_ms.saturating_add(elapsed_ms);
        if self.second_ms >= 1_000 {
            self.count(self.second_ms / 1_000);
            self.second_ms %= 1_000;
        }
    }

    /// Counts seconds; power comes back by 1 % of the rating in each.
    fn count(&mut self, elapsed_s: u32) {
        let elapsed_s = elapsed_s.min(100) as i32;
        let (sum, readings) = core::mem::take(&mut self.readings);
        let wanted = if readings > 0 {
            self.estimate(sum * (ONE_C / 16) / readings, elapsed_s);
            let (from, to) = (
                i32::from(POT_HOT_C) * ONE_C,
                i32::from(POT_TOO_HOT_C) * ONE_C,
            );
            (self.base.clamp(from, to) - from) * 100 / (to - from)
        } else {
            0
        };
        self.taken_percent = wanted.max(self.taken_percent - elapsed_s);
    }

    fn estimate(&mut self, glass: i32, elapsed_s: i32) {
        let mean = self.mean.get_or_insert(glass);
        let above = glass - *mean;
        *mean += above * elapsed_s.min(MEAN_S) / MEAN_S;
        let lead = above * i32::from(POT_LEAD_S) / MEAN_S;
        self.base = *mean + lead + loss(*mean, POT_LOSS_PERCENT);
    }

    /// Power that keeps the pot warm, in watt, at most [`KEEP_WARM_W`]; without a sensor the lowest level's.
    pub fn warm_w(&self) -> u16 {
        let Some(mean) = self.mean else {
            return LEVELS[0].power_w;
        };
        let base = mean + loss(mean, KEEP_WARM_LOSS_PERCENT);
        let missing = i32::from(KEEP_WARM_C) * ONE_C - base;
        let power_w = missing * i32::from(KEEP_WARM_W_PER_K) / ONE_C;
        power_w.clamp(0, i32::from(KEEP_WARM_W)) as u16
    }

    /// Power that is left, in watt: the lowest level's at least.
    pub fn power_w(&self) -> u16 {
        let left_w = i32::from(RATED_POWER_W) * (100 - self.taken_percent) / 100;
        (left_w as u16).max(LEVELS[0].power_w)
    }
}

/// Difference from glass to base at rest, for a share of their conductance that the glass has to the room.
fn loss(glass: i32, percent: i16) -> i32 {
    (glass - ROOM_C * ONE_C).max(0) * i32::from(percent) / 100
}

#[cfg(test)]
mod tests;
