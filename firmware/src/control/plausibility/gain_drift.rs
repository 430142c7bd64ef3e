//! A gain of current or voltage that drifts while a pot stays on the glass.
//!
//! With X = X_L − X_C, a current that reads g times too much makes L look 1/g as large, and moves the balance of the bridge by
//! (1 − g)·X_C·X/|Z|²: by half of the gain's share at 45 kHz, a fifth at 80 kHz. A pot that is moved or gets warm changes L, but the
//! balance holds for any load. The tank's capacitance, the bus and what the mains' filter does to them move the balance, but not L,
//! which is of voltage and current alone. Only a gain moves both, in one direction: the lesser of the two is the drift. The ratio of
//! X_L to R is free of gains, and little of the frequency: another ratio is another pot, or another place of it.
//!
//! One operating point is compared with its own past. A drift stays known when the point changes, less what honest changes
//! bring, until the gains are seen to be right: by a bare coil, or by the same load at the same operating point, for which each
//! start after a trip has [`TRIAL_HALF_CYCLES`].

use crate::estimate::tank::{Tank, TankAt};
use crate::fixed::saturate;
use crate::limits::GAIN_DRIFT_PERMILLE;
use crate::sampling::half_cycle::HalfCycle;

/// Half-cycles whose mean an operating point begins with, and whose weight the mean keeps.
const AVERAGED: u8 = 16;

/// Frequencies further apart than this are different operating points. A gain that is 7 % wrong moves the frequency by 3.6 %.
const POINT_HZ_PERMILLE: u64 = 40;

/// The same limit while an operating point is learned.
const LEARNED_HZ_PERMILLE: u64 = 25;

/// Crests of the bus further apart than this are different operating points.
const POINT_BUS_PERMILLE: u64 = 80;

/// Ratios of X_L to R further apart than this are different loads.
const LOAD_PERMILLE: u64 = 20;

/// L has changed by more than this, and the balance shows less than half of it: so has the load.
const LOAD_PPM: i64 = 20_000;

/// Half-cycles of heating after a trip in which a drift that is known does not count: a soft start, the way back to the operating
/// point, and its mean. There it ends.
const TRIAL_HALF_CYCLES: u8 = 80;

/// A drift that an honest board may show where it leaves an operating point.
const HONEST_PPM: i32 = 15_000;

const LIMIT_PPM: i32 = 1_000 * GAIN_DRIFT_PERMILLE;

/// Quantities that a gain changes, and one that another load changes.
#[derive(Clone, Copy, Debug, Default)]
struct LoadReading {
    l_ph: i32,
    /// Ratio of X_L to R, in 1e-5.
    x_l_to_r: i32,
    /// Ratio of the bridge's voltage by coil and capacitor to that by the bus, in 1e-6.
    balance_ppm: i32,
}

/// Readings of an operating point, and what makes it one.
#[derive(Clone, Copy, Debug, Default)]
struct OperatingPoint {
    f_sw_hz: u32,
    bus_dv: u16,
    learned: LoadReading,
}

/// Drift of a gain since a bare coil was seen, as far as operating points show it.
#[derive(Clone, Debug, Default)]
pub(super) struct GainDrift {
    point: OperatingPoint,
    /// Half-cycles at this operating point, up to [`AVERAGED`].
    half_cycles: u8,
    mean: LoadReading,
    /// Operating point at which the gains were last known to be right, and half-cycles in which they may show that they are again.
    right: OperatingPoint,
    trial: u8,
    /// Share by which the current reads too little, or the voltage too much, since the operating point was learned.
    here_ppm: i32,
    /// The same before.
    before_ppm: i32,
}

impl GainDrift {
    /// Takes a half-cycle of heating with its balance; returns `true` if a gain has drifted too far.
    pub(super) fn push(&mut self, summary: &HalfCycle, balance_ppm: i32) -> bool {
        let crest = &summary.crest;
        let tank = TankAt::new(summary.f_sw_hz).with_load(crest.r, crest.l);
        if tank.x_mohm() > 0 && tank.r_mohm > 0 {
            let reading = LoadReading {
                l_ph: crest.l.0,
                x_l_to_r: saturate(100_000 * tank.x_l_mohm / tank.r_mohm),
                balance_ppm,
            };
            if self.is_elsewhere(summary) {
                self.leave();
            }
            self.average(summary, reading);
            self.compare(tank);
            if self.trial > 0 && self.is_where_it_was_right() {
                self.trial = 0;
                if self.is_right_again(tank) {
                    *self = Self::default();
                }
            }
        }
        self.trial = self.trial.saturating_sub(1);
        self.trial == 0 && self.known_ppm().abs() >= LIMIT_PPM
    }

    /// Leaves the operating point: the load may be another one.
    pub(super) fn leave(&mut self) {
        let known_ppm = self.known_ppm();
        self.before_ppm = if known_ppm.abs() >= LIMIT_PPM {
            known_ppm
        } else {
            known_ppm - known_ppm.clamp(-HONEST_PPM, HONEST_PPM)
        };
        (self.here_ppm, self.half_cycles) = (0, 0);
    }

    /// Begins a trial after a trip: what is known of a drift counts again after it.
    pub(super) fn begin_trial(&mut self) {
        if self.before_ppm == 0 && self.half_cycles == AVERAGED {
            self.right = self.point;
        }
        self.leave();
        self.trial = TRIAL_HALF_CYCLES;
    }

    fn known_ppm(&self) -> i32 {
        self.before_ppm.saturating_add(self.here_ppm)
    }

    fn is_elsewhere(&self, summary: &HalfCycle) -> bool {
        if self.half_cycles < AVERAGED {
            // Bursts are shorter than what is averaged: a sag within one is no part of the mean.
            return self.point.is_other_mains(summary.bus_peak_dv)
                || self.point.is_other_hz(summary.f_sw_hz, LEARNED_HZ_PERMILLE);
        }
        self.point
            .is_another(summary.f_sw_hz, summary.bus_peak_dv, &self.mean)
    }

    /// Returns `true` with the load and at the operating point that there were when the gains were right.
    fn is_where_it_was_right(&self) -> bool {
        let OperatingPoint {
            f_sw_hz, bus_dv, ..
        } = self.point;
        self.half_cycles == AVERAGED && !self.right.is_another(f_sw_hz, bus_dv, &self.mean)
    }

    /// Returns `true` if it reads as it did.
    fn is_right_again(&self, tank: Tank) -> bool {
        let by_l_ppm = self.mean.l_since(&self.right.learned);
        let by_balance_ppm = self.mean.balance_since(&self.right.learned, tank);
        let honest = i64::from(HONEST_PPM);
        by_l_ppm.abs() < honest && by_balance_ppm.abs() < honest
    }

    fn average(&mut self, summary: &HalfCycle, reading: LoadReading) {
        if self.half_cycles == 0 {
            (self.point.f_sw_hz, self.mean) = (summary.f_sw_hz, reading);
        }
        let learns = self.half_cycles < AVERAGED;
        self.half_cycles += u8::from(learns);
        let weight = i64::from(self.half_cycles);
        let towards = |mean: &mut i32, new: i32| {
            *mean = saturate(i64::from(*mean) + (i64::from(new) - i64::from(*mean)) / weight);
        };
        towards(&mut self.mean.l_ph, reading.l_ph);
        towards(&mut self.mean.x_l_to_r, reading.x_l_to_r);
        towards(&mut self.mean.balance_ppm, reading.balance_ppm);
        if learns {
            (self.point.bus_dv, self.point.learned) = (summary.bus_peak_dv, self.mean);
        }
        if learns && self.half_cycles == AVERAGED {
            self.point.f_sw_hz = summary.f_sw_hz;
        }
    }

    fn compare(&mut self, tank: Tank) {
        let by_l_ppm = self.mean.l_since(&self.point.learned);
        let by_balance_ppm = self.mean.balance_since(&self.point.learned, tank);
        let same_way_ppm = by_balance_ppm * by_l_ppm.signum();
        self.here_ppm = saturate(by_l_ppm.abs().min(same_way_ppm.max(0)) * by_l_ppm.signum());
        if by_l_ppm.abs() > LOAD_PPM && 2 * same_way_ppm < by_l_ppm.abs() {
            self.leave();
        }
    }
}

impl LoadReading {
    /// Change of L since another reading, in 1e-6.
    fn l_since(&self, learned: &Self) -> i64 {
        let l_ph = i64::from(learned.l_ph.max(1));
        (i64::from(self.l_ph) - l_ph) * 1_000_000 / l_ph
    }

    /// Share of a gain that moves the balance as much as it has since another reading, in 1e-6.
    fn balance_since(&self, learned: &Self, tank: Tank) -> i64 {
        // |Z|²/(X_C·X), and a quarter more, so that a balance that changes with the frequency hides no drift.
        let (r, x) = (tank.r_mohm, tank.x_mohm());
        let moved_ppm = i64::from(self.balance_ppm) - i64::from(learned.balance_ppm);
        moved_ppm.saturating_mul(5 * (r * r + x * x)) / (4 * tank.x_c_mohm * x).max(1)
    }
}

impl OperatingPoint {
    fn is_other_hz(&self, f_sw_hz: u32, permille: u64) -> bool {
        differ(f_sw_hz.into(), self.f_sw_hz.into(), permille)
    }

    fn is_other_mains(&self, bus_dv: u16) -> bool {
        differ(bus_dv.into(), self.bus_dv.into(), POINT_BUS_PERMILLE)
    }

    /// Returns `true` if frequency, mains or load are others.
    fn is_another(&self, f_sw_hz: u32, bus_dv: u16, reading: &LoadReading) -> bool {
        let ratio = |reading: &LoadReading| reading.x_l_to_r.unsigned_abs().into();
        self.is_other_mains(bus_dv)
            || self.is_other_hz(f_sw_hz, POINT_HZ_PERMILLE)
            || differ(ratio(reading), ratio(&self.learned), LOAD_PERMILLE)
    }
}

/// Returns `true` if two quantities are further apart than this share of the second.
fn differ(a: u64, b: u64, permille: u64) -> bool {
    a.abs_diff(b) * 1_000 > b * permille
}

#[cfg(test)]
mod tests {
    use ihd_shared::fault::Fault;

    use super::super::Plausibility;
    use super::super::tests::{BARE, POT, SMALL, seen};
    use super::*;

    /// Fault of a second of heating at gains of voltage and current.
    fn heated(
        plausibility: &mut Plausibility,
        f_hz: f64,
        pot: (f64, f64),
        v: f64,
        i: f64,
    ) -> Fault {
        heated_for(plausibility, 100, (f_hz, pot, v, i))
    }

    fn heated_for(
        plausibility: &mut Plausibility,
        half_cycles: u32,
        (f_hz, pot, v, i): (f64, (f64, f64), f64, f64),
    ) -> Fault {
        (0..half_cycles)
            .find_map(|_| plausibility.on_half_cycle(&seen(f_hz, pot, v, i, 1.0)))
            .unwrap_or(Fault::NONE)
    }

    /// Half-cycles until a fault.
    fn found_after(
        plausibility: &mut Plausibility,
        reading: impl Fn(u32) -> HalfCycle,
    ) -> Option<u32> {
        (1..=6_000).find(|&n| plausibility.on_half_cycle(&reading(n)).is_some())
    }

    /// A power that is wrong by 5 % is 1/0.95 or 1/1.05 of a gain.
    #[test]
    fn a_gain_that_steps_by_4_percent_is_found_within_half_a_second() {
        for f_hz in [45e3, 52e3, 65e3, 79e3] {
            for pot in [POT, SMALL] {
                for (v, i) in [
                    (1.0, 0.96),
                    (1.0, 1.05),
                    (0.95, 1.0),
                    (1.04, 1.0),
                    (1.0, 0.93),
                    (1.0, 1.07),
                ] {
                    let mut plausibility = Plausibility::default();
                    assert_eq!(heated(&mut plausibility, f_hz, pot, 1.0, 1.0), Fault::NONE);
                    let after = found_after(&mut plausibility, |_| seen(f_hz, pot, v, i, 1.0));
                    assert!(
                        after.is_some_and(|n| n <= 50),
                        "{f_hz} {pot:?} {v} {i}: {after:?}"
                    );
                }
            }
        }
    }

    /// 0.1 % a second, as the frequency follows the power: −1/2.6 of it.
    #[test]
    fn a_slow_drift_is_found_before_the_power_is_wrong_by_5_percent() {
        for sign in [-1.0, 1.0] {
            let mut plausibility = Plausibility::default();
            heated(&mut plausibility, 50e3, POT, 1.0, 1.0);
            let gain = |n: u32| 1.0 + sign * 1e-5 * f64::from(n);
            let after = found_after(&mut plausibility, |n| {
                seen(50e3 * (1.0 + (gain(n) - 1.0) / 2.6), POT, 1.0, gain(n), 1.0)
            });
            let error = 1.0 / gain(after.unwrap()) - 1.0;
            assert!(error.abs() < 0.05, "{error}");
        }
    }

    /// Changes that a kitchen brings: the pot's place and temperature, the power, the mains; and the bus's gain, on which no power depends.
    #[test]
    fn no_honest_change_is_a_drift() {
        let mut plausibility = Plausibility::default();
        for (f_hz, (r, l_uh)) in [
            (50e3, (3.0, 20.0)),
            // Moved, at the same frequency and at the one that follows.
            (50e3, (2.8, 20.8)),
            (48e3, (2.7, 20.9)),
            // Warm: R and L by a tenth.
            (48e3, (2.75, 21.2)),
            (48e3, (2.82, 21.8)),
            (48e3, (2.9, 22.5)),
            (48e3, (2.97, 23.1)),
            // Another power.
            (67e3, (4.1, 20.5)),
            (43e3, (2.5, 19.2)),
        ] {
            for bus in [1.0, 1.03, 0.98, 0.99] {
                for _ in 0..60 {
                    let summary = seen(f_hz, (r, l_uh), 1.0, 1.0, bus);
                    assert_eq!(
                        plausibility.on_half_cycle(&summary),
                        None,
                        "{f_hz} {r} {l_uh} {bus}"
                    );
                }
            }
        }
    }

    /// Neither a trip nor a probe with the pot makes a gain right; a bare coil that is as it must be shows it is, and so does the same
    /// load at the same place.
    #[test]
    fn a_drift_stands_until_the_gains_are_seen_to_be_right() {
        let mut plausibility = Plausibility::default();
        let (right, wrong) = ((50e3, POT, 1.0, 1.0), (50e3, POT, 1.0, 0.95));
        let heat = |plausibility: &mut Plausibility, (f_hz, pot, v, i)| {
            heated(plausibility, f_hz, pot, v, i)
        };
        assert_eq!(heat(&mut plausibility, right), Fault::NONE);
        assert_eq!(heat(&mut plausibility, wrong), Fault::BRIDGE_BALANCE);
        for _ in 0..3 {
            plausibility.reset();
            assert_eq!(
                plausibility.on_pot_probe(&seen(79_911.0, POT, 1.0, 0.95, 1.0)),
                None
            );
            assert_eq!(heat(&mut plausibility, wrong), Fault::BRIDGE_BALANCE);
        }
        // 7 % too much hides in a coil that metal may be near.
        for (i, fault) in [(1.07, Fault::BRIDGE_BALANCE), (1.0, Fault::NONE)] {
            plausibility.reset();
            plausibility.on_pot_probe(&seen(79_911.0, BARE, 1.0, i, 1.0));
            assert_eq!(heat(&mut plausibility, (50e3, POT, 1.0, i)), fault, "{i}");
        }
        for (i, f_hz) in [(0.93, 52e3), (1.07, 48.5e3)] {
            let mut plausibility = Plausibility::default();
            assert_eq!(heat(&mut plausibility, right), Fault::NONE);
            for _ in 0..2 {
                let fault = heat(&mut plausibility, (f_hz, POT, 1.0, i));
                assert_eq!(fault, Fault::BRIDGE_BALANCE, "{i}");
                plausibility.reset();
            }
            // On the way there, and then for as long as it takes.
            for f_hz in [79e3, 60e3, 50e3, 50e3] {
                assert_eq!(
                    heated_for(&mut plausibility, 20, (f_hz, POT, 1.0, 1.0)),
                    Fault::NONE
                );
            }
            assert_eq!(heat(&mut plausibility, right), Fault::NONE, "{i}");
            let fault = heat(&mut plausibility, (f_hz, POT, 1.0, i));
            assert_eq!(fault, Fault::BRIDGE_BALANCE, "{i}");
        }
        // Another pot shows nothing of it.
        let mut plausibility = Plausibility::default();
        heat(&mut plausibility, right);
        assert_eq!(heat(&mut plausibility, wrong), Fault::BRIDGE_BALANCE);
        plausibility.reset();
        let fault = heat(&mut plausibility, (50e3, SMALL, 1.0, 1.0));
        assert_eq!(fault, Fault::BRIDGE_BALANCE);
    }
}
