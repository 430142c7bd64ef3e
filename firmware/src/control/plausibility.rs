//! Readings that contradict physics or each other, half-cycle by half-cycle.
//!
//! The coil's voltage and that of the resonance capacitor, I/(jωC), add up to the bridge's, whose
//! fundamental is 2/π of the bus and a share of its ripple. That ties the gains of three sensors together without a fourth: with
//! X_L and X_C the two reactances, a current that reads g times too much moves the sum by
//! (g − 1)·X_C, a voltage by (g − 1)·|R + jX_L|, the bus directly. Near 80 kHz X_C is a tenth of X_L
//! and an error of the current's gain is lost in the tolerances; a sensor of the DC link sees it there.
//!
//! The bare coil is a known impedance: nothing that a kitchen has raises its inductance. A pot probe without a pot that
//! finds more of it has a current that reads too little, or a voltage that reads too much; and the balance of voltage and bus at
//! the probe frequency hardly asks for C_r.
//!
//! `gain_drift` compares both with their own past, while a pot stays.
//!
//! A capacitor in series lets no direct current through, and a winding holds no direct voltage: the
//! means over whole periods are zero, bridge on or off. A current that swings through zero has codes on both
//! sides of it, unless a bit of its converter sticks.

use ihd_shared::board::BARE_COIL_NH;
use ihd_shared::fault::Fault;

use self::gain_drift::GainDrift;
use crate::control::bus_ripple::{BRIDGE_SHARE, ripple_dv};
use crate::estimate::tank::{TankAt, resonance_capacitor_mohm};
use crate::fixed::{Complex, saturate};
use crate::limits::{
    BALANCE_PERCENT, BALANCE_TANK_PERCENT, BARE_BALANCE_PERMILLE, BARE_COIL_MOHM,
    BARE_COIL_PERCENT, BUS_AT_CROSSING_PERCENT, BUS_MIN_DV, CURRENT_OFFSET_MA,
    IMPLAUSIBLE_HALF_CYCLES, IRREGULAR_HALF_CYCLES, LINK_CAPACITANCE_MAX_NF, POWER_BALANCE_PERCENT,
    PROBE_BALANCE_PERCENT, VOLTAGE_OFFSET_DV,
};
use crate::sampling::half_cycle::HalfCycle;
use crate::sampling::half_cycle_sums::filter_loss_q16;
use crate::sense::demodulator::{STATE_BITS, VOLT_PER_UNIT, amplitude_dv};

mod gain_drift;

/// Crest of a bus up to which a bench supply may hold it, in decivolt: 120 V (docs/bring-up.md) and their error. It is no mains, and
/// shows no zero crossing out of place.
const BENCH_BUS_DV: u16 = 1_250;

/// Share of the bus's ripple in the bridge's fundamental, per decivolt as a mantissa of the coil's voltage.
const RIPPLE_SHARE_PER_DV: i64 =
    (BRIDGE_SHARE * 0.1 / VOLT_PER_UNIT * (1_u64 << STATE_BITS) as f64) as i64;

/// Share of the bare coil's L that no error of a gain leaves: below, metal stands there.
const METAL_L_PERCENT: u32 = 75;

/// Power from which on the two powers are compared: 200 W.
const POWER_FROM_MW: u32 = 200_000;

/// Contradictions between the measurements, each counted in half-cycles that it lasts.
#[derive(Clone, Debug, Default)]
pub struct Plausibility {
    balance: ContradictionCount,
    probe: ContradictionCount,
    offset: ContradictionCount,
    gap: ContradictionCount,
    current: ContradictionCount,
    power: ContradictionCount,
    bus: ContradictionCount,
    drift: GainDrift,
    /// A bit for each of the last eight half-cycles that was not as it must be.
    irregular: u8,
}

/// Half-cycles, or pot probes, in a row.
#[derive(Clone, Copy, Debug, Default)]
struct ContradictionCount(u8);

impl ContradictionCount {
    fn push(&mut self, bad: bool) -> bool {
        self.push_if(true, bad)
    }

    /// Counts a half-cycle; one that shows nothing neither counts nor ends the count. Returns `true` once enough in a row were bad.
    fn push_if(&mut self, shows: bool, bad: bool) -> bool {
        if shows {
            self.0 = if bad { self.0.saturating_add(1) } else { 0 };
        }
        self.0 >= IMPLAUSIBLE_HALF_CYCLES
    }
}

impl Plausibility {
    /// Takes a half-cycle; the fault that has lasted long enough.
    pub fn on_half_cycle(&mut self, summary: &HalfCycle) -> Option<Fault> {
        let steady = summary.f_sw_hz > 0 && !summary.disturbed;
        // Without current the soft limits disturb every half-cycle.
        let on_bus = summary.f_sw_hz > 0 && summary.is_comparable();
        let flows = summary.has_coil_current();
        let seen = steady && on_bus && flows;
        // More than any offset that is none yet.
        let swings = summary.f_sw_hz > 0 && summary.crest.i_ma >= 2 * CURRENT_OFFSET_MA;
        let balance = BridgeBalance::from_half_cycle(summary);
        let checks = [
            (self.offset.push(has_offset(summary)), Fault::SENSOR_OFFSET),
            (
                self.gap.push_if(swings, summary.channels.i_gap),
                Fault::SENSOR_OFFSET,
            ),
            (
                self.balance.push_if(seen, !balance.is_within_tolerances()),
                Fault::BRIDGE_BALANCE,
            ),
            (
                seen && self.drift.push(summary, balance.ppm()),
                Fault::BRIDGE_BALANCE,
            ),
            (
                self.power.push_if(steady, !is_power_balanced(summary)),
                Fault::POWER_BALANCE,
            ),
            (self.current.push_if(on_bus, !flows), Fault::NO_COIL_CURRENT),
            (
                // On a bench without power the bridge may switch.
                self.bus
                    .push_if(summary.f_sw_hz > 0, summary.bus_peak_dv < BUS_MIN_DV),
                Fault::BUS_RANGE,
            ),
            (self.is_irregular(summary), Fault::MAINS_IRREGULAR),
        ];
        checks
            .into_iter()
            .find_map(|(bad, fault)| bad.then_some(fault))
    }

    /// Returns `true` while coil and capacitor contradict the bus, which no load makes them do.
    pub fn is_balance_off(&self) -> bool {
        self.balance.0 > 0
    }

    /// Takes a pot probe; the fault that has lasted long enough.
    pub fn on_pot_probe(&mut self, summary: &HalfCycle) -> Option<Fault> {
        let flows = summary.is_comparable() && summary.has_coil_current();
        let is_bare = summary.crest.r.0 <= 1_000 * BARE_COIL_MOHM as i32;
        let l_ph = i64::from(summary.crest.l.0);
        let bare_ph = |percent: u32| i64::from(BARE_COIL_NH * 10 * percent);
        let balance = BridgeBalance::from_half_cycle(summary);
        // Aluminium takes no more power than the winding, and leaves half of its L at most.
        let is_coil_alone = is_bare && l_ph >= bare_ph(METAL_L_PERCENT);
        let bad = if is_coil_alone {
            l_ph > bare_ph(100 + BARE_COIL_PERCENT)
                || !balance.is_within_permille(BARE_BALANCE_PERMILLE)
        } else {
            !balance.is_within_permille(10 * PROBE_BALANCE_PERCENT)
        };
        if flows && is_bare && !bad && l_ph >= bare_ph(100 - BARE_COIL_PERCENT) {
            self.drift = GainDrift::default();
        }
        self.drift.leave();
        // A load that fits shows little of what the bare coil contradicts.
        let shows = flows && (is_coil_alone || bad);
        self.probe
            .push_if(shows, bad)
            .then_some(Fault::BRIDGE_BALANCE)
    }

    /// Forgets what was counted; a gain that has drifted has a trial to show that it is right again.
    pub fn reset(&mut self) {
        self.drift.begin_trial();
        *self = Self {
            drift: core::mem::take(&mut self.drift),
            ..Self::default()
        };
    }

    fn is_irregular(&mut self, summary: &HalfCycle) -> bool {
        // A link that little discharges stays up, so only a bridge that carries power shows its zero.
        let limit_dv = u32::from(summary.bus_peak_dv) * BUS_AT_CROSSING_PERCENT / 100;
        let in_place = summary.f_sw_hz == 0
            || !discharges_link(summary)
            || summary.bus_peak_dv <= BENCH_BUS_DV
            || u32::from(summary.bus_at_crossing_dv) <= limit_dv;
        self.irregular = self.irregular << 1 | u8::from(!(summary.is_in_time() && in_place));
        self.irregular.count_ones() >= IRREGULAR_HALF_CYCLES
    }
}

/// Returns `true` if the power of the half-cycle takes the charge of the DC link down to 15 % of the crest by the zero crossing.
///
/// A load of resistance R leaves the rectified sine at the angle θ before the crossing where tan θ = ωRC, and from there on the link
/// decays with RC: sin θ · exp(−θ/tan θ) of the crest is left at the crossing, 15 % with tan θ = 0.42. With P = V̂²/2R that is
/// P = ωC·V̂²/0.84, and ω is π a half-cycle.
fn discharges_link(summary: &HalfCycle) -> bool {
    let bus_dv = u64::from(summary.bus_peak_dv);
    // nF · dV² / ns = 1e-2 W; π/0.84 = 3.74.
    let least_mw = 3_740 * u64::from(LINK_CAPACITANCE_MAX_NF) * bus_dv * bus_dv
        / (100 * u64::from(summary.duration_ns.max(1)));
    u64::from(summary.power_mw) > least_mw
}

fn has_offset(summary: &HalfCycle) -> bool {
    summary.channels.i_offset_ma.unsigned_abs() >= CURRENT_OFFSET_MA
        || summary.channels.v_offset_dv.unsigned_abs() >= VOLTAGE_OFFSET_DV
}

/// The bridge's fundamental by coil and capacitor, less what the bus's ripple adds to it, against 2/π of the bus: amplitudes before
/// the anti-alias filter, at the crest of the current, in decivolt.
struct BridgeBalance {
    by_coil_dv: u32,
    by_bus_dv: u32,
    /// X_C·X/|Z|², by which an error of C_r or of the current's gain moves the sum, in permille; at most 1.
    by_tank_permille: u32,
}

impl BridgeBalance {
    fn from_half_cycle(summary: &HalfCycle) -> Self {
        // Without a frequency X_C has 38 bits.
        let x_c_mohm = i64::from(saturate(resonance_capacitor_mohm(summary.f_sw_hz)));
        let filtered_dv = bridge_dv(summary, x_c_mohm);
        // √(1 + x) ≈ 1 + x/2 of the anti-alias filter.
        let tank = TankAt::new(summary.f_sw_hz).with_load(summary.crest.r, summary.crest.l);
        let z_mohm = i64::from(saturate(tank.z_mohm() as i64));
        let by_tank = x_c_mohm * tank.x_mohm() / (z_mohm * z_mohm / 1_000).max(1);
        let loss_dv = (filtered_dv * (filter_loss_q16(summary.f_sw_hz) / 2)) >> 16;
        Self {
            by_coil_dv: filtered_dv + loss_dv,
            by_bus_dv: u32::from(summary.crest.bus.dv) * 6_366 / 10_000,
            by_tank_permille: by_tank.clamp(0, 1_000) as u32,
        }
    }

    /// Returns `true` if the two differ by no more than the parts and sensors of an honest board let them.
    fn is_within_tolerances(&self) -> bool {
        let tank_permille = BALANCE_TANK_PERCENT * self.by_tank_permille / 100;
        self.is_within_permille(10 * BALANCE_PERCENT + tank_permille)
    }

    fn is_within_permille(&self, permille: u32) -> bool {
        self.by_coil_dv.abs_diff(self.by_bus_dv) * 1_000 <= self.by_bus_dv * permille
    }

    /// Their ratio, in millionths.
    fn ppm(&self) -> i32 {
        saturate(i64::from(self.by_coil_dv) * 1_000_000 / i64::from(self.by_bus_dv.max(1)))
    }
}

/// Amplitude of |V + I/(jωC_r)| less the share of the bus's ripple, in decivolt.
fn bridge_dv(summary: &HalfCycle, x_c_mohm: i64) -> u32 {
    let (v, i) = (summary.crest.phasors.v, summary.crest.phasors.i);
    let ripple = ripple_dv(&summary.crest.bus, summary.f_sw_hz);
    // −jX·(a + jb) = bX − jaX; mantissas of 16 A and 32 V, so an ohm counts half.
    let part = |v: i32, i: i32, ripple_dv: i32| {
        let ripple = i64::from(ripple_dv) * RIPPLE_SHARE_PER_DV;
        saturate(i64::from(v) + i64::from(i) * x_c_mohm / 2_000 - ripple)
    };
    let sum = Complex {
        re: part(v.re, i.im, ripple.re),
        im: part(v.im, -i.re, ripple.im),
    };
    amplitude_dv(sum.norm_squared())
}

fn is_power_balanced(summary: &HalfCycle) -> bool {
    let Some(dc_link_mw) = summary.dc_link_mw else {
        return true;
    };
    let more = dc_link_mw.max(summary.power_mw);
    more < POWER_FROM_MW
        || u64::from(dc_link_mw.abs_diff(summary.power_mw)) * 100
            <= u64::from(more) * u64::from(POWER_BALANCE_PERCENT)
}

#[cfg(test)]
mod tests;
