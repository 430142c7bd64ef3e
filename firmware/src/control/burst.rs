//! Power below what the highest frequency gives: bursts of whole mains cycles.
//!
//! Every [`BURST_PERIOD_MS`] the energy that is due is given at [`crate::limits::BURST_POWER_W`]; what a burst gives
//! too much or too little, because it has whole cycles, the next one makes good. So the mean follows
//! the measured energy exactly, and no direct current is drawn from the mains. While a supply is shared a burst waits for its turn
//! ([`super::supply_share`]).

use crate::control::restart::is_reached;
use crate::control::supply_share::SupplyShare;
use crate::limits::{
    BURST_PERIOD_MS, BURST_POWER_W, BUS_AT_START_DV, HANDOVER_HALF_CYCLES, SHARED_BURST_HALF_CYCLES,
};
use crate::sampling::half_cycle::HalfCycle;

/// Periods whose energy is given at once, at most, while a supply is shared.
const SHARED_PERIODS: i64 = 4;

/// Action for the bridge after a half-cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BurstStep {
    /// Nothing changes.
    Keep,
    /// Begin a burst.
    On,
    /// End it with the half-cycle that runs now.
    OffAtCrossing,
}

/// The energy that is due, and the cycles of the burst.
#[derive(Clone, Debug)]
pub struct PowerBursts {
    /// Energy that is due, in microjoule; negative where too much was given.
    due_uj: i64,
    next_ms: u32,
    /// A burst is due, and waits for the supply.
    waits: bool,
    on: bool,
    ending: bool,
    /// The burst ends with the next whole cycle, for a probe; the rest follows.
    is_cut: bool,
    /// Half-cycles of this burst that were over when the supply was left to the other zone.
    released_at: Option<u16>,
    /// Energy was lost to the limit of saved-up periods, and the balance is still positive.
    short: bool,
    /// Half-cycles of this burst that are over; before it begins, those since the claim.
    half_cycles: u32,
}

impl PowerBursts {
    /// Begins with the bridge on, `half_cycles` of which are over; or with the bridge off, and a burst that is due.
    pub fn new(asked_w: u16, now_ms: u32, half_cycles: Option<u32>) -> Self {
        Self {
            due_uj: period_uj(asked_w),
            next_ms: now_ms.wrapping_add(BURST_PERIOD_MS),
            waits: half_cycles.is_none(),
            on: half_cycles.is_some(),
            half_cycles: half_cycles.unwrap_or(0),
            ending: false,
            is_cut: false,
            released_at: None,
            short: false,
        }
    }

    /// Returns `true` if less is given than was asked, as the other zone has the supply.
    pub fn is_short(&self) -> bool {
        self.short
    }

    /// Returns `true` while a burst is under way.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Returns `true` if a burst is due, and waits for the supply, or for a probe.
    pub fn is_waiting(&self) -> bool {
        self.waits
    }

    /// Ends a burst that is under way with its next whole cycle; what it has not given waits.
    pub fn cut_short(&mut self) {
        self.is_cut = self.on;
    }

    /// Counts the energy of a half-cycle or a pot probe.
    pub fn count(&mut self, summary: &HalfCycle) -> i64 {
        let given_uj = i64::from(summary.power_mw) * i64::from(summary.duration_ns) / 1_000_000;
        self.due_uj -= given_uj;
        given_uj
    }

    /// Takes a half-cycle that is over; claims and releases the supply. No burst begins unless it `may_start`.
    pub fn on_half_cycle(
        &mut self,
        summary: &HalfCycle,
        asked_w: u16,
        now_ms: u32,
        may_start: bool,
        supply: &mut SupplyShare,
    ) -> BurstStep {
        let given_uj = self.count(summary);
        if is_reached(now_ms, self.next_ms) {
            self.next_ms = now_ms.wrapping_add(BURST_PERIOD_MS);
            self.begin_period(asked_w, supply.is_shared());
        }
        if !self.on {
            return self.begin(summary, may_start, supply);
        }
        if self.ending {
            // Without regard to its last half-cycle: a mains that was away may have opened the bridge before.
            (self.on, self.ending) = (false, false);
            return BurstStep::Keep;
        }
        if summary.f_sw_hz == 0 {
            return BurstStep::Keep;
        }
        self.half_cycles += 1;
        let is_last = self.is_last(given_uj, supply);
        // With the half-cycle that runs now the burst has whole cycles.
        if self.half_cycles.is_multiple_of(2) || !is_last {
            return BurstStep::Keep;
        }
        supply.release();
        self.ending = true;
        // It was ended early.
        let most_uj = if self.is_cut { 2 } else { HANDOVER_HALF_CYCLES };
        self.waits |= self.due_uj > i64::from(most_uj) * given_uj;
        BurstStep::OffAtCrossing
    }

    /// Adds the energy of a period. Nothing is saved up beyond a period, or the other zone's turn: a hob that could not give it does
    /// not make up for it.
    fn begin_period(&mut self, asked_w: u16, is_shared: bool) {
        let periods = if is_shared { SHARED_PERIODS } else { 2 };
        let period_uj = period_uj(asked_w);
        let due_uj = self.due_uj + period_uj;
        self.due_uj = due_uj.min(periods * period_uj).max(-most_debt_uj());
        self.short = due_uj > self.due_uj || (self.short && self.due_uj > 0);
        self.waits |= self.due_uj > 0;
    }

    /// Begins a burst that waits, if it may and the supply is free.
    fn begin(
        &mut self,
        summary: &HalfCycle,
        may_start: bool,
        supply: &mut SupplyShare,
    ) -> BurstStep {
        if !self.waits || !may_start || !supply.claim() {
            self.half_cycles = 0;
            return BurstStep::Keep;
        }
        // A link that the other zone discharges would let the bridge begin before that one ends.
        let is_early = supply.is_shared()
            && summary.bus_at_crossing_dv < BUS_AT_START_DV
            && self.half_cycles < HANDOVER_HALF_CYCLES - 2;
        if is_early {
            self.half_cycles += 1;
            return BurstStep::Keep;
        }
        (self.on, self.waits, self.released_at) = (true, false, None);
        (self.ending, self.is_cut, self.half_cycles) = (false, false, 0);
        BurstStep::On
    }

    /// Returns `true` if the burst has no further whole cycle; releases a shared supply before.
    fn is_last(&mut self, given_uj: i64, supply: &mut SupplyShare) -> bool {
        match self.released_at {
            Some(at) => self.half_cycles >= u32::from(at) + HANDOVER_HALF_CYCLES - 1,
            // The other zone has taken it.
            None if !supply.holds() => true,
            None if supply.is_shared() => {
                let is_over = self.half_cycles >= SHARED_BURST_HALF_CYCLES
                    || self.due_uj <= i64::from(HANDOVER_HALF_CYCLES) * given_uj;
                if self.half_cycles.is_multiple_of(2) && is_over {
                    supply.release();
                    self.released_at = u16::try_from(self.half_cycles).ok();
                }
                false
            }
            // Half of the next whole cycle would already be too much.
            None => self.is_cut || self.due_uj - given_uj < given_uj,
        }
    }
}

/// Energy of a period, in microjoule.
fn period_uj(asked_w: u16) -> i64 {
    i64::from(asked_w) * i64::from(BURST_PERIOD_MS) * 1_000
}

/// Excess that later bursts make good, in microjoule, at most: probes alone give more than a watt, for hours.
fn most_debt_uj() -> i64 {
    period_uj(BURST_POWER_W)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const HALF_CYCLE_MS: u32 = 10;

    /// Mean power of ten seconds after two, and the half-cycles of each burst.
    fn bursts(asked_w: u16, burst_w: u32) -> (f64, Vec<u32>) {
        let mut supply = SupplyShare::default();
        let mut burst = PowerBursts::new(asked_w, 0, Some(0));
        let (mut energy_j, mut lengths, mut length) = (0.0, Vec::new(), 0);
        // The bridge begins a half-cycle late: it charges its bootstrap capacitor first.
        let (mut bridge, mut charging) = (true, false);
        for k in 0..1_200 {
            let power_w = if bridge { burst_w } else { 0 };
            if k >= 200 {
                energy_j += f64::from(power_w) * f64::from(HALF_CYCLE_MS) * 1e-3;
            }
            length += u32::from(bridge);
            let summary = HalfCycle {
                f_sw_hz: u32::from(bridge) * 70_000,
                power_mw: power_w * 1_000,
                duration_ns: HALF_CYCLE_MS * 1_000_000,
                ..HalfCycle::default()
            };
            let ended = bridge && burst.ending;
            let now_ms = (k + 1) * HALF_CYCLE_MS;
            let step = burst.on_half_cycle(&summary, asked_w, now_ms, true, &mut supply);
            if ended {
                lengths.push(core::mem::take(&mut length));
                bridge = false;
            }
            bridge |= core::mem::replace(&mut charging, step == BurstStep::On);
        }
        (energy_j / 10.0, lengths)
    }

    #[test]
    fn the_mean_is_what_was_asked_for_and_every_burst_has_whole_cycles() {
        for asked_w in [100, 150, 270, 400, 640] {
            for burst_w in [650, 720, 800] {
                let (mean_w, lengths) = bursts(asked_w, burst_w);
                let error = mean_w / f64::from(asked_w) - 1.0;
                assert!(error.abs() < 0.02, "{asked_w} {burst_w}: {mean_w}");
                assert!(lengths.len() >= 7, "{asked_w} {burst_w}: {lengths:?}");
                assert!(lengths.iter().all(|n| n % 2 == 0), "{lengths:?}");
            }
        }
    }

    /// An hour on a glass that is hot enough: probes of 1.1 J, .7 s apart, and no burst. Without the limit of a debt the next 500 W
    /// would begin 12 s late.
    #[test]
    fn what_hours_of_probes_gave_holds_no_later_power_back() {
        let mut supply = SupplyShare::default();
        let mut burst = PowerBursts::new(0, 0, Some(0));
        let idle = HalfCycle {
            duration_ns: HALF_CYCLE_MS * 1_000_000,
            ..HalfCycle::default()
        };
        let probe = HalfCycle {
            power_mw: 110_000,
            ..idle
        };
        let heats = HalfCycle {
            f_sw_hz: 70_000,
            power_mw: 700_000,
            ..idle
        };
        for _ in 0..2 {
            burst.on_half_cycle(&heats, 0, 0, false, &mut supply);
        }
        assert!(!burst.is_on(), "one whole cycle");
        for k in 1..=360_000 {
            if k % 70 == 0 {
                burst.count(&probe);
            }
            burst.on_half_cycle(&idle, 0, k * HALF_CYCLE_MS, false, &mut supply);
        }
        let begins = |k: &u32| {
            let now_ms = (360_000 + k) * HALF_CYCLE_MS;
            burst.on_half_cycle(&idle, 500, now_ms, true, &mut supply) == BurstStep::On
        };
        // At most 720 J too much were given: two periods of 500 W.
        let late = (1..).find(begins).unwrap();
        assert!(late <= 201, "{late} half-cycles");
    }
}
