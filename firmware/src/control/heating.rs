//! State Heating: the pot is watched, and its power regulated or given in bursts.

use ihd_shared::wire::messages::{Limit, Pot};

use crate::control::burst::{BurstStep, PowerBursts};
use crate::control::parts::ControlParts;
use crate::control::pot::classify;
use crate::control::pot_watch::PotWatch;
use crate::control::status::{Action, SamplingStatus};
use crate::drive::bridge::Drive;
use crate::drive::pwm;
use crate::limits::{
    BURST_POWER_W, POT_GONE_HALF_CYCLES, UNSEEN_HALF_CYCLES, UNSEEN_WAITING_HALF_CYCLES,
};
use crate::sampling::half_cycle::HalfCycle;

/// Half-cycles in a row at the highest frequency with too much power before bursts begin.
const EXCESS_HALF_CYCLES: u8 = 2;

/// Excess over the granted power that is too much.
const MAX_EXCESS_PERCENT: u64 = 1;

/// Consequence of a half-cycle of heating.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeatingStep {
    /// Heating goes on.
    Act(Action),
    /// The pot is away, or cannot be heated.
    PotLost(Pot),
    /// The pot was not seen for too long, or may have gone from a sheet: a probe is due.
    Probe,
}

/// A pot being heated.
#[derive(Clone, Debug)]
pub struct Heating {
    /// Start of the time in which the bridge may switch without a judged pot, in milliseconds.
    unjudged_since_ms: u32,
    /// Half-cycles in a row that showed none.
    without_pot: u8,
    /// Half-cycles in a row at the highest frequency with more power than was granted.
    with_excess: u8,
    /// Power up to which it is given in bursts, as no frequency gives as little; 0 until that was seen.
    bursts_to_w: u16,
    /// Bursts under way.
    bursts: Option<PowerBursts>,
    /// Half-cycles since the bridge last began or stopped to switch; a probe that saw the pot counts as a stop.
    half_cycles: u32,
    /// R and L since the last probe: a sheet may take the pot's place.
    watch: PotWatch,
    limit: Limit,
    last: HalfCycle,
}

impl Heating {
    /// Begins with a pot that was judged now.
    pub fn new(now_ms: u32) -> Self {
        Self {
            unjudged_since_ms: now_ms,
            without_pot: 0,
            with_excess: 0,
            bursts_to_w: 0,
            bursts: None,
            half_cycles: 0,
            watch: PotWatch::new(now_ms),
            limit: Limit::None,
            last: HalfCycle::default(),
        }
    }

    /// Start of the time in which the bridge may switch without a judged pot, in milliseconds.
    pub fn unjudged_since_ms(&mut self) -> &mut u32 {
        &mut self.unjudged_since_ms
    }

    /// Limit of pot or temperature that holds the power below what was requested.
    pub fn limit(&self) -> Limit {
        self.limit
    }

    /// Takes a half-cycle that is over.
    pub fn on_half_cycle(
        &mut self,
        summary: &HalfCycle,
        status: &SamplingStatus,
        parts: &mut ControlParts,
    ) -> HeatingStep {
        let changes = (summary.f_sw_hz > 0) != (self.last.f_sw_hz > 0);
        let before = if changes { 0 } else { self.half_cycles };
        self.half_cycles = before.wrapping_add(1);
        self.last = *summary;
        if summary.f_sw_hz > 0 && !summary.disturbed {
            match classify(summary, parts.pot) {
                pot @ (Pot::Ferromagnetic | Pot::Small) => {
                    parts.pot = pot;
                    parts.heated_hz = summary.f_sw_hz;
                    self.without_pot = 0;
                    self.unjudged_since_ms = status.now_ms;
                    if !parts.is_balance_off {
                        self.watch.note(summary, status.now_ms);
                    }
                }
                // Too little mains to say.
                Pot::Unknown => return HeatingStep::Act(Action::Keep),
                pot => {
                    self.without_pot += 1;
                    return if self.without_pot >= POT_GONE_HALF_CYCLES {
                        HeatingStep::PotLost(pot)
                    } else {
                        HeatingStep::Act(Action::Keep)
                    };
                }
            }
        }
        if summary.f_sw_hz > 0 {
            parts.restart.heated();
        }
        let action = self.set_power(summary, status, parts);
        if action == Action::Keep && self.is_probe_due(status, parts) {
            return HeatingStep::Probe;
        }
        HeatingStep::Act(action)
    }

    /// Takes a probe between two bursts, or two half-cycles.
    pub fn on_probe(&mut self, summary: &HalfCycle, now_ms: u32) {
        self.half_cycles = 0;
        self.watch.probed(now_ms);
        if let Some(bursts) = &mut self.bursts {
            bursts.count(summary);
        }
    }

    /// Goes on after a probe that found a pot.
    pub fn go_on(&self, heated_hz: u32) -> Action {
        match &self.bursts {
            // Begun meanwhile, by another request.
            Some(bursts) if bursts.is_on() => Action::Drive(Drive::switching(heated_hz)),
            _ => Action::Keep,
        }
    }

    /// Half-cycles without power in which nothing showed the pot.
    fn unseen(&self) -> u32 {
        let is_on = self.bursts.as_ref().is_some_and(PowerBursts::is_on);
        if is_on || self.last.f_sw_hz > 0 {
            0
        } else {
            self.half_cycles
        }
    }

    /// Returns `true` if the pot may be another one by now, or a sheet. While the other zone has the supply it is looked at less often.
    fn is_unseen(&self, is_shared: bool) -> bool {
        let most = if is_shared {
            UNSEEN_WAITING_HALF_CYCLES
        } else {
            UNSEEN_HALF_CYCLES
        };
        self.watch.is_probe_due() || self.unseen() >= most
    }

    fn is_probe_due(&self, status: &SamplingStatus, parts: &mut ControlParts) -> bool {
        let is_due = self.bursts.as_ref().is_none_or(PowerBursts::is_waiting);
        let is_unseen = is_due && self.is_unseen(parts.supply_share.is_shared());
        (is_unseen || self.unseen() >= UNSEEN_WAITING_HALF_CYCLES)
            && !status.requested.is_switching()
            && !status.switching
            && parts.restart.permits(status.now_ms)
    }

    /// Begins a search for a power that was just requested: the last half-cycle is as good as the next, 10 ms sooner.
    pub fn follow_request(&mut self, parts: &mut ControlParts) {
        if self.bursts.is_some() || parts.power.is_searching() || self.watch.is_probe_due() {
            return;
        }
        if self.last.f_sw_hz > 0 && !self.last.disturbed {
            let granted_w = self.grant(parts);
            parts.power.begin(&self.last, u64::from(granted_w) * 1_000);
        }
    }

    fn grant(&mut self, parts: &ControlParts) -> u16 {
        let (granted_w, limit) = parts.granted_w();
        self.limit = limit;
        granted_w
    }

    fn set_power(
        &mut self,
        summary: &HalfCycle,
        status: &SamplingStatus,
        parts: &mut ControlParts,
    ) -> Action {
        let granted_w = self.grant(parts);
        self.watch_least_power(summary, granted_w);
        parts.supply_share.note(summary.power_mw);
        if parts.supply_share.is_shared() || granted_w <= self.bursts_to_w {
            return self.give_bursts(summary, granted_w, status, parts);
        }
        self.bursts = None;
        match (parts.supply_share.claim(), status.requested.is_switching()) {
            (true, true) if self.watch.is_probe_due() && summary.f_sw_hz > 0 => {
                parts.power.cancel();
                return Action::OffAtCrossing;
            }
            (true, true) => regulate(summary, granted_w, status, parts),
            (true, false) if parts.restart.permits(status.now_ms) && !self.is_unseen(false) => {
                return Action::Drive(Drive::switching(parts.heated_hz));
            }
            (false, true) => return Action::OffAtCrossing,
            (_, false) => {}
        }
        Action::Keep
    }

    /// Counts half-cycles with more power than was granted and no higher frequency: then bursts, as long as no more than that
    /// power is granted.
    fn watch_least_power(&mut self, summary: &HalfCycle, granted_w: u16) {
        if granted_w <= self.bursts_to_w {
            return;
        }
        let too_much = summary.f_sw_hz == pwm::MAX_HZ
            && u64::from(summary.power_mw) > u64::from(granted_w) * 10 * (100 + MAX_EXCESS_PERCENT);
        self.with_excess = if too_much { self.with_excess + 1 } else { 0 };
        if self.with_excess >= EXCESS_HALF_CYCLES {
            self.with_excess = 0;
            let least_w = summary.power_mw / (10 * (100 + MAX_EXCESS_PERCENT as u32));
            self.bursts_to_w = u16::try_from(least_w).unwrap_or(u16::MAX);
        }
    }

    fn give_bursts(
        &mut self,
        summary: &HalfCycle,
        granted_w: u16,
        status: &SamplingStatus,
        parts: &mut ControlParts,
    ) -> Action {
        // The half-cycle that is just over is counted by the burst itself, unless the bridge is only about to switch.
        let is_switching = status.requested.is_switching();
        let before = is_switching.then(|| match summary.f_sw_hz {
            0 => 0,
            _ => self.half_cycles.saturating_sub(1),
        });
        let is_unseen = self.is_unseen(parts.supply_share.is_shared());
        let bursts = self
            .bursts
            .get_or_insert_with(|| PowerBursts::new(granted_w, status.now_ms, before));
        if self.watch.is_probe_due() && !parts.supply_share.is_shared() {
            bursts.cut_short();
        }
        let may_start = parts.restart.permits(status.now_ms) && !is_unseen && !is_switching;
        let supply = &mut parts.supply_share;
        let (is_shared, shared_w) = (supply.is_shared(), supply.burst_w());
        let step = bursts.on_half_cycle(summary, granted_w, status.now_ms, may_start, supply);
        if is_shared && bursts.is_short() && self.limit == Limit::None {
            self.limit = Limit::SharedSupply;
        }
        match step {
            BurstStep::On => {
                parts.power.cancel();
                Action::Drive(Drive::switching(parts.heated_hz))
            }
            BurstStep::OffAtCrossing => {
                parts.power.cancel();
                Action::OffAtCrossing
            }
            BurstStep::Keep => {
                if bursts.is_on() {
                    let most_w = parts.most_w().0.max(BURST_POWER_W);
                    let burst_w = if is_shared { shared_w } else { BURST_POWER_W };
                    regulate(summary, burst_w.max(granted_w).min(most_w), status, parts);
                }
                Action::Keep
            }
        }
    }
}

/// Begins a search for the frequency, unless the half-cycle is of another one.
#[inline(never)]
fn regulate(summary: &HalfCycle, power_w: u16, status: &SamplingStatus, parts: &mut ControlParts) {
    // A thread too slow for one search a half-cycle ends the old one first.
    if summary.f_sw_hz == status.requested.f_sw_hz
        && summary.f_sw_hz > 0
        && !summary.disturbed
        && !parts.power.is_searching()
    {
        parts.power.begin(summary, u64::from(power_w) * 1_000);
    }
}
