//! Power below the floor, which the highest frequency gives: bursts of whole mains cycles.
//!
//! Every [`BURST_PERIOD_MS`] the energy that is due is given at [`crate::limits::BURST_POWER_W`]; what a burst gives
//! too much or too little, because it has whole cycles, the next one makes good. So the mean follows
//! the measured energy exactly, and no direct current is drawn from the mains.

use crate::control::restart::is_reached;
use crate::limits::BURST_PERIOD_MS;
use crate::sampling::half_cycle::HalfCycle;

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
    on: bool,
    ending: bool,
    /// Half-cycles of this burst that are over.
    half_cycles: u32,
}

impl PowerBursts {
    /// Begins with the bridge on, `half_cycles` of which are over.
    pub fn new(asked_w: u16, now_ms: u32, half_cycles: u32) -> Self {
        Self {
            due_uj: period_uj(asked_w),
            next_ms: now_ms.wrapping_add(BURST_PERIOD_MS),
            on: true,
            half_cycles,
            ending: false,
        }
    }

    /// Returns `true` while a burst is under way.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Takes a half-cycle that is over.
    pub fn on_half_cycle(&mut self, summary: &HalfCycle, asked_w: u16, now_ms: u32) -> BurstStep {
        let given_uj = i64::from(summary.power_mw) * i64::from(summary.duration_ns) / 1_000_000;
        self.due_uj -= given_uj;
        let is_due = is_reached(now_ms, self.next_ms);
        if is_due {
            self.next_ms = now_ms.wrapping_add(BURST_PERIOD_MS);
            // Nothing is saved up beyond a period: a hob that could not give it does not make up for it.
            let period_uj = period_uj(asked_w);
            self.due_uj = (self.due_uj + period_uj).min(2 * period_uj);
        }
        if !self.on {
            if !is_due || self.due_uj <= 0 {
                return BurstStep::Keep;
            }
            (self.on, self.ending, self.half_cycles) = (true, false, 0);
            return BurstStep::On;
        }
        if self.ending {
            if summary.f_sw_hz > 0 {
                (self.on, self.ending) = (false, false);
            }
            return BurstStep::Keep;
        }
        if summary.f_sw_hz == 0 {
            return BurstStep::Keep;
        }
        self.half_cycles += 1;
        // With the half-cycle that runs now the burst has whole cycles, and half of the next whole
        // cycle would already be too much.
        if self.half_cycles % 2 == 1 && self.due_uj - given_uj < given_uj {
            self.ending = true;
            return BurstStep::OffAtCrossing;
        }
        BurstStep::Keep
    }
}

/// Energy of a period, in microjoule.
fn period_uj(asked_w: u16) -> i64 {
    i64::from(asked_w) * i64::from(BURST_PERIOD_MS) * 1_000
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const HALF_CYCLE_MS: u32 = 10;

    /// Mean power of ten seconds after two, and the half-cycles of each burst.
    fn bursts(asked_w: u16, burst_w: u32) -> (f64, Vec<u32>) {
        let mut burst = PowerBursts::new(asked_w, 0, 0);
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
            let step = burst.on_half_cycle(&summary, asked_w, (k + 1) * HALF_CYCLE_MS);
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
}
