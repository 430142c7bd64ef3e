//! A pot is heated: the pot is watched, the power is regulated, or given in bursts.

use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::{Limit, Pot};

use super::{Action, Control, Now};
use crate::burst::Step;
use crate::half_cycle::Summary;
use crate::limits::{BURST_POWER_W, POT_GONE_HALF_CYCLES, SMALL_POT_PERCENT};
use crate::pot::classify;
use crate::pwm;
use crate::realtime::Drive;

/// Half-cycles in a row at the highest frequency with too much power before bursts begin.
const FLOOR_HALF_CYCLES: u8 = 2;

/// How much is too much.
const TOO_MUCH_PERCENT: u64 = 1;

impl Control {
    pub(super) fn heat(&mut self, summary: &Summary, now: &Now) -> Action {
        if summary.f_sw_hz > 0 && !summary.disturbed {
            match classify(summary, self.pot) {
                pot @ (Pot::Ferromagnetic | Pot::Small) => {
                    self.pot = pot;
                    self.without_pot = 0;
                    self.judged_ms = now.ms;
                    self.heated_hz = summary.f_sw_hz;
                }
                // Too little mains to say.
                Pot::Unknown => return Action::Keep,
                pot => {
                    self.without_pot += 1;
                    if self.without_pot >= POT_GONE_HALF_CYCLES {
                        return self.lose_pot(pot, now);
                    }
                    return Action::Keep;
                }
            }
        }
        self.restart.heating(now.ms);
        let granted_w = self.granted_w();
        self.watch_floor(summary, granted_w);
        if granted_w == self.bursts_for_w {
            return self.give_bursts(summary, granted_w, now);
        }
        if core::mem::take(&mut self.bursting) && !now.wanted.is_switching() {
            return Action::Drive(Drive::switching(self.heated_hz));
        }
        self.regulate(summary, granted_w, now);
        Action::Keep
    }

    /// Begins a search for the frequency, unless the summary is of another one.
    fn regulate(&mut self, summary: &Summary, power_w: u16, now: &Now) {
        // A thread too slow for one search a half-cycle ends the old one first.
        if summary.f_sw_hz == now.wanted.f_sw_hz
            && summary.f_sw_hz > 0
            && !summary.disturbed
            && !self.power.is_searching()
        {
            self.power.begin(summary, u64::from(power_w) * 1_000);
        }
    }

    /// More power than was asked for, and no higher frequency: bursts, as long as the same power is
    /// asked for.
    fn watch_floor(&mut self, summary: &Summary, granted_w: u16) {
        if granted_w == self.bursts_for_w {
            return;
        }
        self.bursts_for_w = 0;
        let too_much = summary.f_sw_hz == pwm::HIGHEST_HZ
            && u64::from(summary.power_mw) > u64::from(granted_w) * 10 * (100 + TOO_MUCH_PERCENT);
        self.at_floor = if too_much { self.at_floor + 1 } else { 0 };
        if self.at_floor >= FLOOR_HALF_CYCLES {
            self.at_floor = 0;
            self.bursts_for_w = granted_w;
        }
    }

    fn give_bursts(&mut self, summary: &Summary, granted_w: u16, now: &Now) -> Action {
        if !self.bursting {
            self.bursting = true;
            // The half-cycle that is just over is counted below.
            let before = self.half_cycles_on.wrapping_sub(1);
            self.burst.begin(granted_w, now.ms, before);
        }
        match self.burst.on_half_cycle(summary, granted_w, now.ms) {
            Step::On if self.restart.permits(now.ms) => {
                self.power.cancel();
                Action::Drive(Drive::switching(self.heated_hz))
            }
            Step::On => Action::Keep,
            Step::OffAtCrossing => {
                self.power.cancel();
                Action::OffAtCrossing
            }
            Step::Keep => {
                if self.burst.is_on() {
                    self.regulate(summary, BURST_POWER_W.max(granted_w), now);
                }
                Action::Keep
            }
        }
    }

    /// What is given of what was asked for, in watt.
    pub(super) fn granted_w(&mut self) -> u16 {
        let asked_w = self.request.power_w();
        let hot_w =
            (u32::from(RATED_POWER_W) * u32::from(self.temperatures.power_percent()) / 100) as u16;
        let pot_w = if self.pot == Pot::Small {
            (u32::from(RATED_POWER_W) * u32::from(SMALL_POT_PERCENT) / 100) as u16
        } else {
            RATED_POWER_W
        };
        self.limit = if asked_w > hot_w {
            Limit::Temperature
        } else if asked_w > pot_w {
            Limit::SmallPot
        } else {
            Limit::None
        };
        asked_w.min(pot_w).min(hot_w)
    }
}
