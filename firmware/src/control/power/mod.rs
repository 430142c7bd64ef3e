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
//! block: [`INSTRUCTIONS_PER_STEP`], so that the watchdog is fed in between, and at most
//! [`STEPS_PER_SEARCH`]. Eleven blocks are 0.4 ms at 80 kHz and 1 ms at 34 kHz; where a step takes
//! longer than a block (0.6 ms at two cycles an instruction, the sampling path taking 60 % of them),
//! 7 ms of a half-cycle's 8.3. The drive takes effect at the next zero crossing anyway.

pub mod bounds;
pub mod memory;
pub mod prediction;

use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::Limit;

use crate::drive::pwm;
use crate::estimate::tank::Tank;
use crate::limits::{
    DEAD_BAND_PERCENT, RESONANCE_MARGIN_PERCENT, STEP_DOWN_HZ, STEP_UP_HZ, TAUGHT_STEP_DOWN_HZ,
};
use crate::sampling::half_cycle::HalfCycle;
use bounds::Bounds;
use memory::OperatingMemory;
use prediction::predict;

/// Range of the learnt factor, in 1/1024: 0.4 to 2.5.
const FACTOR_Q10: core::ops::RangeInclusive<u64> = 410..=2_560;

/// A lookup whose factor lies here predicts well enough to go all the way at once: 0.8 to 1.25.
const TRUSTED_Q10: core::ops::RangeInclusive<u64> = 819..=1_280;

/// Instructions of one step, at most.
pub const INSTRUCTIONS_PER_STEP: u32 = 20_000;

/// Steps of one search, at most: one to learn the factor, then the widest bracket, 30 kHz, is halved
/// until it is no wider than the grid is at 34 kHz.
pub const STEPS_PER_SEARCH: u32 = 11;

/// The smallest step for a measured error, in hertz: above resonance P ∝ f^−2 to f^−6, so a
/// sixth of the relative error never overshoots.
fn trim_hz(f_sw_hz: u32, error_mw: u64, asked_mw: u64) -> u32 {
    let trim = u64::from(f_sw_hz) * error_mw / (6 * asked_mw.max(1));
    trim.min(u64::from(TAUGHT_STEP_DOWN_HZ)) as u32
}

/// The largest step, in smallest ones: half of the relative error, for P ∝ f^−2. What the lookup
/// solves for counts between the two.
const MAX_OF_TRIM: u32 = 3;

/// Power control's memory, and the search that is under way.
#[derive(Clone, Debug)]
pub struct PowerControl {
    factor_q10: u64,
    memory: OperatingMemory,
    /// Frequency at which the same pot was heated before it was away, in hertz; 0 for none.
    resume_hz: u32,
    limit: Limit,
    search: Option<Search>,
}

impl Default for PowerControl {
    fn default() -> Self {
        Self {
            factor_q10: 1_024,
            memory: OperatingMemory::default(),
            resume_hz: 0,
            limit: Limit::None,
            search: None,
        }
    }
}

/// A frequency being searched for a half-cycle.
#[derive(Clone, Copy, Debug)]
struct Search {
    summary: HalfCycle,
    asked_mw: u64,
    bounds: Bounds,
    /// Between these two lies the frequency, in hertz; `None` until the factor is learnt.
    bracket_hz: Option<(u32, u32)>,
    /// Limit that forbade a lower frequency.
    refused: Limit,
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

    /// Ends the search without a result.
    pub fn cancel(&mut self) {
        self.search = None;
        self.limit = Limit::None;
    }

    /// Returns `true` while a search is under way.
    pub fn is_searching(&self) -> bool {
        self.search.is_some()
    }

    /// Limit that held the power below the request in the last search.
    pub fn limit(&self) -> Limit {
        self.limit
    }

    /// Takes note of a half-cycle: mains, pot, soft limits.
    pub fn note(&mut self, summary: &HalfCycle, now_ms: u32) {
        self.memory.note(summary, now_ms);
    }

    /// Begins to search the frequency for the next half-cycle. `asked_mw` above zero, the inverter
    /// running.
    pub fn begin(&mut self, summary: &HalfCycle, asked_mw: u64) {
        self.search = Some(Search {
            summary: *summary,
            asked_mw,
            bounds: Bounds::new(summary, self.memory.bus_dv().max(summary.bus_peak_dv)),
            bracket_hz: None,
            refused: Limit::None,
        });
    }

    /// One step of the search, one prediction at most; the frequency, of the grid, once it is found.
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
        let may_jump = self.resume_hz > 0 || lookup.observed_cells() > 0;
        let step_down_hz = if may_jump {
            TAUGHT_STEP_DOWN_HZ
        } else {
            STEP_DOWN_HZ
        };
        let (mut low, mut high) = search.by_measurement(step_down_hz);
        let floor = self.memory.floor_hz(&search.summary);
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

/// Distance of two frequencies of the grid, f²/22.3 MHz, in hertz.
fn grid_step_hz(f_sw_hz: u32) -> u32 {
    (f_sw_hz >> 10) * (f_sw_hz >> 10) / 21
}

impl Search {
    fn now_hz(&self) -> u32 {
        self.summary.f_sw_hz.clamp(F_SW_MIN_HZ, F_SW_MAX_HZ)
    }

    fn error_mw(&self) -> i64 {
        i64::from(self.summary.power_mw) - self.asked_mw as i64
    }

    fn is_within_dead_band(&self) -> bool {
        self.error_mw().unsigned_abs() * 100 <= self.asked_mw * u64::from(DEAD_BAND_PERCENT)
    }

    /// Lowest and highest frequency by the measured power; both alike where it alone decides.
    fn by_measurement(&self, step_down_hz: u32) -> (u32, u32) {
        let (summary, asked_mw) = (&self.summary, self.asked_mw);
        let now = self.now_hz();
        let measured = Tank::new(now, summary.r, summary.l);
        let error = self.error_mw();
        let trim = trim_hz(now, error.unsigned_abs(), asked_mw);
        let most = MAX_OF_TRIM * trim;
        if summary.i_crest_ma > 0 && !measured.is_above_resonance(RESONANCE_MARGIN_PERCENT / 2) {
            // The load is not the lookup's: leave resonance first.
            (now + STEP_UP_HZ, now + STEP_UP_HZ)
        } else if self.is_within_dead_band() {
            (now, now)
        } else if error > 0 {
            (now + trim.min(STEP_UP_HZ), now + most.min(STEP_UP_HZ))
        } else if measured.is_above_resonance(RESONANCE_MARGIN_PERCENT) {
            (now - most.min(step_down_hz), now - trim.min(STEP_DOWN_HZ))
        } else {
            // More power lies below the margin.
            (now, now)
        }
    }

    /// Limit that holds the power at a frequency that was found.
    fn held_by(&self, f_sw_hz: u32) -> Limit {
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

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::lookup::prior::prior;

    /// A plant whose power is the prediction times a factor the control does not know.
    fn settle(asked_w: u64, plant: f64) -> (u32, f64) {
        settle_on(&prior(), &prior(), asked_w, plant)
    }

    /// All of a search at once, and its steps.
    fn search(
        control: &mut PowerControl,
        summary: &HalfCycle,
        asked_mw: u64,
        lookup: &RlLookup,
    ) -> (u32, u32) {
        control.begin(summary, asked_mw);
        for step in 1..=STEPS_PER_SEARCH {
            if let Some(f_sw_hz) = control.advance(lookup) {
                assert!(!control.is_searching());
                return (f_sw_hz, step);
            }
        }
        panic!("{asked_mw} mW from {summary:?} takes more steps");
    }

    fn settle_on(load: &RlLookup, lookup: &RlLookup, asked_w: u64, plant: f64) -> (u32, f64) {
        let mut control = PowerControl::default();
        let mut f = pwm::HIGHEST_HZ;
        let mut power = 0.0;
        for _ in 0..60 {
            power = predict(load, f, 3_253).map_or(0.0, |p| p.power_mw as f64 * plant);
            let (r, l) = load.interpolate(f, 30_000);
            let summary = HalfCycle {
                f_sw_hz: f,
                power_mw: power as u32,
                bus_peak_dv: 3_253,
                i_crest_ma: 30_000,
                r,
                l,
                ..HalfCycle::default()
            };
            let (next, _) = search(&mut control, &summary, asked_w * 1_000, lookup);
            assert_eq!(next, pwm::nearest_hz(next));
            // Half of the grid's widest step beyond.
            assert!(
                next + STEP_DOWN_HZ + 144 >= f && next <= f + STEP_UP_HZ + 144,
                "{f} -> {next}"
            );
            f = next;
        }
        (f, power / 1e3)
    }

    #[test]
    fn reaches_the_asked_power_whatever_the_lookup_misses() {
        // 0.7 of what 68 A and the margin allow are 1,870 W.
        for asked in [700, 1_000, 1_500, 1_800] {
            for plant in [0.7, 1.0, 1.3] {
                let (_, power) = settle(asked, plant);
                let error = (power / asked as f64 - 1.0).abs();
                assert!(error <= 0.02, "{asked} W, plant {plant}: {power}");
            }
        }
    }

    #[test]
    fn more_than_the_load_can_take_stops_at_the_margin() {
        let (f, power) = settle(2_500, 0.5);
        assert!(power < 2_500.0);
        assert!(
            predict(&prior(), f, 3_253).is_some(),
            "it must stay above resonance"
        );
    }

    /// Taught up to 45 A with a load of less R and L than the prior, which the cells above keep: at
    /// the seam the prediction falls with falling frequency.
    #[test]
    fn a_half_taught_lookup_does_not_hold_the_frequency() {
        let mut lookup = prior();
        let taught = |cell: u16| (f32::from(cell) * 0.8) as u16;
        for row in lookup.r.iter_mut().chain(&mut lookup.l) {
            row[..13].iter_mut().for_each(|cell| *cell = taught(*cell));
        }
        // The plant is the load that the lookup was taught with, at every current.
        let mut plant = prior();
        for row in plant.r.iter_mut().chain(&mut plant.l) {
            row.iter_mut().for_each(|cell| *cell = taught(*cell));
        }
        let power = settle_on(&plant, &lookup, 1_900, 1.0).1;
        assert!((power / 1_900.0 - 1.0).abs() <= 0.02, "{power}");
    }

    #[test]
    fn a_load_near_resonance_sends_the_frequency_up() {
        let mut control = PowerControl::default();
        let summary = HalfCycle {
            f_sw_hz: 40_000,
            power_mw: 100_000,
            bus_peak_dv: 3_253,
            i_crest_ma: 20_000,
            r: ihd_shared::units::MicroOhm(3_000_000),
            l: ihd_shared::units::PicoHenry(15_000_000),
            ..HalfCycle::default()
        };
        let next = search(&mut control, &summary, 2_000_000, &prior());
        // 8 kHz away from resonance, and further still: saturated, this load takes 70 A at 49 kHz.
        assert!((48_000..52_000).contains(&next.0), "{next:?}");
    }

    /// The oracle: bisection over the whole range at once, then the measurement's bounds.
    fn whole_range(summary: &HalfCycle, asked_mw: u64, lookup: &RlLookup, factor_q10: u64) -> u32 {
        let (mut low, mut high) = (F_SW_MIN_HZ, F_SW_MAX_HZ);
        while high - low > 1 {
            let middle = low.midpoint(high);
            match predict(lookup, middle, summary.bus_peak_dv) {
                Some(p) if (p.power_mw * factor_q10) >> 10 <= asked_mw => high = middle,
                _ => low = middle,
            }
        }
        let now = summary.f_sw_hz;
        let error = i64::from(summary.power_mw) - asked_mw as i64;
        let trim = trim_hz(now, error.unsigned_abs(), asked_mw).min(STEP_UP_HZ);
        if error > 0 {
            high.clamp(now + trim, now + (3 * trim).min(STEP_UP_HZ))
        } else {
            high.clamp(
                now - (3 * trim).min(STEP_DOWN_HZ),
                now - trim.min(STEP_DOWN_HZ),
            )
        }
        .clamp(F_SW_MIN_HZ, F_SW_MAX_HZ)
    }

    /// In its steps, which are few, the search finds what it would find at once.
    #[test]
    fn a_search_in_steps_finds_the_frequency_of_one_over_the_whole_range() {
        let lookup = prior();
        let mut taught = prior();
        taught.observed.fill(0xFF);
        let mut most_steps = 0;
        for asked_mw in (300_000..=2_500_000).step_by(170_000) {
            for f in (40_000..F_SW_MAX_HZ).step_by(1_777) {
                let f_sw_hz = pwm::nearest_hz(f);
                for plant_percent in [40, 80, 130, 230] {
                    let Some(predicted) = predict(&lookup, f_sw_hz, 3_253) else {
                        continue;
                    };
                    let power_mw = predicted.power_mw * plant_percent / 100;
                    if power_mw.abs_diff(asked_mw) * 100 <= asked_mw * 2 {
                        continue;
                    }
                    let (r, l) = lookup.interpolate(f_sw_hz, 30_000);
                    let summary = HalfCycle {
                        f_sw_hz,
                        power_mw: power_mw as u32,
                        bus_peak_dv: 3_253,
                        i_crest_ma: 30_000,
                        r,
                        l,
                        ..HalfCycle::default()
                    };
                    let mut control = PowerControl::default();
                    let (found, steps) = search(&mut control, &summary, asked_mw, &lookup);
                    let at_once = whole_range(&summary, asked_mw, &lookup, control.factor_q10);
                    // One step of the grid.
                    let tolerance = grid_step_hz(at_once) * 5 / 4;
                    assert!(
                        found.abs_diff(at_once) <= tolerance,
                        "{asked_mw} {f_sw_hz} {plant_percent}: {found} {at_once}"
                    );
                    let (_, steps_if_taught) =
                        search(&mut PowerControl::default(), &summary, asked_mw, &taught);
                    most_steps = most_steps.max(steps).max(steps_if_taught);
                }
            }
        }
        assert!(
            most_steps >= STEPS_PER_SEARCH - 1,
            "{most_steps}: tighten it"
        );
    }

    /// At the start of a half-cycle of 60 Hz, at any frequency, there are blocks enough.
    #[test]
    fn a_search_ends_well_before_the_next_zero_crossing() {
        for f_sw_hz in [F_SW_MIN_HZ, F_SW_MAX_HZ] {
            let block_ns = ihd_shared::sampling::block_ns(f_sw_hz);
            assert!((1 + STEPS_PER_SEARCH) * block_ns < 8_333_333 / 5);
        }
    }
}
