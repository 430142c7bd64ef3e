//! Power control: the switching frequency that gives the requested power, from the lookup.
//!
//! Above resonance the power falls with frequency, so the frequency is found by bisection on the
//! power that the lookup predicts. What the prediction misses (harmonics, an untaught lookup) is a
//! factor, learnt from the measured power of each half-cycle. The sign of the error is the
//! measurement's: a lookup with few observations can predict a power that falls where the load's
//! rises, and must not hold the frequency there. Steps per half-cycle are bounded, and inside the
//! dead band the frequency stays, so that windows have one frequency.
//!
//! Where the lookup rests on observations the step may go all the way at once.
//! The limits of a frequency follow from [`bounds`], by the measured load and no lookup, and
//! from [`memory`], by recent events of mains and pot.
//!
//! A search is cut into steps of one prediction each ([`PowerControl::advance`]), one after each
//! block (instructions: `search-step` in firmware/budget.toml), so that the watchdog is fed in between, and at most
//! [`STEPS_PER_SEARCH`]. Eleven blocks are 0.4 ms at 80 kHz and 1 ms at 34 kHz; where a step takes
//! longer than a block (0.5 ms at two cycles an instruction, the sampling path taking half of them),
//! 5 ms of a half-cycle's 8.3. The drive takes effect at the next zero crossing anyway.

pub mod bounds;
pub mod memory;
pub mod prediction;
mod search;

use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::Limit;

use crate::drive::pwm;
use crate::limits::{NEAR_BUS_DV, STEP_DOWN_HZ, STEP_UP_HZ, TAUGHT_STEP_DOWN_HZ};
use crate::sampling::half_cycle::HalfCycle;
use bounds::Bounds;
use memory::OperatingMemory;
use prediction::predict;
use search::{Search, grid_step_hz, small_link_ripple_dv};

/// Range of the learnt factor, in 1/1024: 0.4 to 2.5.
const FACTOR_Q10: core::ops::RangeInclusive<u64> = 410..=2_560;

/// A lookup whose factor lies here predicts well enough to go all the way at once: 0.8 to 1.25.
const TRUSTED_Q10: core::ops::RangeInclusive<u64> = 819..=1_280;

/// Steps of one search, at most: one to learn the factor, then the widest bracket, 30 kHz, is halved
/// until it is no wider than the grid is at 34 kHz.
pub const STEPS_PER_SEARCH: u32 = 11;

/// Power control's memory, and the search that is under way.
#[derive(Clone, Debug)]
pub struct PowerControl {
    factor_q10: u64,
    memory: OperatingMemory,
    /// Frequency at which the same pot was heated before it was away, in hertz; 0 for none.
    resume_hz: u32,
    /// The last search went further down than a step.
    has_jumped: bool,
    /// A jump has tripped the bridge with this pot: the frequency falls in steps only.
    in_steps: bool,
    limit: Limit,
    search: Option<Search>,
}

impl Default for PowerControl {
    fn default() -> Self {
        Self {
            factor_q10: 1_024,
            memory: OperatingMemory::default(),
            resume_hz: 0,
            has_jumped: false,
            in_steps: false,
            limit: Limit::None,
            search: None,
        }
    }
}

impl PowerControl {
    /// Forgets the learnt factor, for another load, and what was searched. What the mains was like is
    /// kept.
    pub fn restart(&mut self) {
        *self = Self {
            memory: self.memory.of_mains(),
            ..Self::default()
        };
    }

    /// Pauses while the pot or the mains is away; the pot that comes back is probably the same.
    pub fn pause(&mut self, f_sw_hz: u32) {
        self.cancel();
        self.memory = self.memory.of_mains();
        self.resume_hz = f_sw_hz;
    }

    /// Takes note of a trip by too much power: after a jump the frequency falls in steps only, for as long as the pot is the same.
    pub fn note_trip(&mut self) {
        self.in_steps |= self.has_jumped;
    }

    /// Ends the search without a result.
    pub fn cancel(&mut self) {
        self.search = None;
        self.limit = Limit::None;
    }

    /// Returns `true` while a search is under way.
    pub fn is_searching(&self) -> bool {
        self.search.is_some()
    }

    /// Drops a search that began from the load at another frequency than this one, in hertz.
    pub fn keep_search_from(&mut self, f_sw_hz: u32) {
        self.search
            .take_if(|search| search.summary.f_sw_hz != f_sw_hz);
    }

    /// Limit that held the power below the request in the last search.
    pub fn limit(&self) -> Limit {
        self.limit
    }

    /// Takes note of a half-cycle: mains, pot, soft limits.
    pub fn note(&mut self, summary: &HalfCycle, now_ms: u32) {
        self.memory.note(summary, now_ms);
    }

    /// Returns `true` if the load of a half-cycle or a probe keeps all limits at a frequency, on the mains that was seen lately.
    pub fn permits(&self, summary: &HalfCycle, f_sw_hz: u32) -> bool {
        let bus_dv = self.memory.bus_dv().max(summary.bus_peak_dv);
        Bounds::new(summary, bus_dv).limit_at(f_sw_hz) == Limit::None
    }

    /// Begins to search the frequency for the next half-cycle. `asked_mw` above zero, the inverter
    /// running.
    pub fn begin(&mut self, summary: &HalfCycle, asked_mw: u64) {
        let bus_dv = self.memory.bus_dv().max(summary.bus_peak_dv);
        let ripple_dv = small_link_ripple_dv(summary);
        self.memory.note_ripple(summary, ripple_dv);
        self.search = Some(Search {
            summary: *summary,
            asked_mw,
            bounds: Bounds::new(summary, bus_dv).with_small_link(summary, ripple_dv),
            ripple_dv,
            bracket_hz: None,
            refused: Limit::None,
        });
    }

    /// Takes a step of the search, one prediction at most; returns the frequency, of the grid, once it is found.
    ///
    /// The smallest change is f/300, more than half of the grid's f²/22.3 MHz at every
    /// frequency, so rounding never swallows it.
    pub fn advance(&mut self, lookup: &RlLookup) -> Option<u32> {
        let mut search = self.search.take()?;
        let (low, high) = match search.bracket_hz {
            None => {
                self.learn(&search.summary, lookup);
                self.bracket(&mut search, lookup)
            }
            Some((low, high)) => {
                let middle = low.midpoint(high);
                if self.is_enough(&mut search, middle, lookup) {
                    (low, middle)
                } else {
                    (middle, high)
                }
            }
        };
        if high - low <= grid_step_hz(low) {
            self.limit = search.held_by(high);
            self.has_jumped = high + STEP_DOWN_HZ < search.now_hz();
            return Some(pwm::nearest_hz(low.midpoint(high)));
        }
        search.bracket_hz = Some((low, high));
        self.search = Some(search);
        None
    }

    fn learn(&mut self, summary: &HalfCycle, lookup: &RlLookup) {
        let predicted = predict(lookup, summary.f_sw_hz, summary.bus_peak_dv);
        if let Some(predicted) = predicted.filter(|p| p.power_mw > 0) {
            let ratio = (u64::from(summary.power_mw) << 10) / predicted.power_mw;
            // Half of the way at once: the measurement is of this frequency, the use of another.
            self.factor_q10 = (self.factor_q10 + ratio) / 2;
            self.factor_q10 = self
                .factor_q10
                .clamp(*FACTOR_Q10.start(), *FACTOR_Q10.end());
        }
    }

    /// Lowest and highest frequency that measurement, memory and bounds allow; both alike where they
    /// alone decide.
    fn bracket(&self, search: &mut Search, lookup: &RlLookup) -> (u32, u32) {
        let now = search.now_hz();
        let is_known = self.resume_hz > 0 || lookup.observed_cells() > 0;
        let may_jump = is_known && !self.in_steps && search.ripple_dv == 0;
        let step_down_hz = if search.summary.bus_peak_dv >= NEAR_BUS_DV {
            STEP_DOWN_HZ / 4
        } else if may_jump {
            TAUGHT_STEP_DOWN_HZ
        } else {
            STEP_DOWN_HZ
        };
        let (mut low, mut high) = search.by_measurement(step_down_hz);
        if high < now && search.is_bus_full() {
            search.refused = Limit::BusVoltage;
            (low, high) = (now, now);
        }
        let floor = self.memory.floor_hz(&search.summary, search.ripple_dv);
        if low < floor.f_sw_hz {
            search.refused = floor.limit;
            low = floor.f_sw_hz;
        }
        high = high.max(low);
        let limit = search.bounds.limit_at(high);
        if limit != Limit::None {
            search.refused = limit;
            (low, high) = (high, high.max(now) + STEP_UP_HZ);
        }
        let rated = |f_sw_hz: u32| f_sw_hz.clamp(F_SW_MIN_HZ, F_SW_MAX_HZ);
        (rated(low), rated(high))
    }

    /// Returns `true` if a frequency gives less than the requested power or all of it, so that a lower one may be tried.
    fn is_enough(&self, search: &mut Search, f_sw_hz: u32, lookup: &RlLookup) -> bool {
        let limit = search.bounds.limit_at(f_sw_hz);
        if limit != Limit::None {
            search.refused = limit;
            return false;
        }
        let Some(predicted) = predict(lookup, f_sw_hz, search.summary.bus_peak_dv) else {
            return false;
        };
        if f_sw_hz + STEP_DOWN_HZ < search.now_hz() {
            let known = lookup.is_observed_at(f_sw_hz, predicted.i_crest_ma)
                && TRUSTED_Q10.contains(&self.factor_q10);
            let returning = self.resume_hz > 0 && f_sw_hz >= self.resume_hz;
            if !known && !returning {
                return false;
            }
        }
        (predicted.power_mw * self.factor_q10) >> 10 <= search.asked_mw
    }
}

#[cfg(test)]
mod tests;
