//! Power control: the switching frequency that gives the asked power, from the lookup.
//!
//! Above resonance the power falls with frequency, so the frequency is found by bisection on the
//! power that the lookup predicts. What the prediction misses (harmonics, an untaught lookup) is a
//! factor, learnt from the measured power of each half-cycle. The sign of the error is the
//! measurement's: a lookup that is half taught can predict a power that falls where the load's
//! rises, and must not hold the frequency there. Steps per half-cycle are bounded, and inside the
//! dead band the frequency stays, so that windows have one frequency.

use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::lookup::RlLookup;

use crate::half_cycle::Summary;
use crate::impedance::Tank;
use crate::pwm;

/// Reactance kept above resonance at the crest, in percent of the coil's: 12 % of X are 6 % of f.
pub const RESONANCE_MARGIN_PERCENT: i64 = 12;

/// Crest current the prediction may ask for: 70 A, below the trip level.
const I_CREST_MAX_MA: u64 = 70_000;

/// Largest step down (towards more power) per half-cycle, in hertz.
pub const STEP_DOWN_HZ: u32 = 2_500;

/// Largest step up (towards less power) per half-cycle, in hertz.
pub const STEP_UP_HZ: u32 = 8_000;

/// Dead band of the mean power, in percent of the asked power.
pub const DEAD_BAND_PERCENT: u32 = 2;

/// Range of the learnt factor, in 1/1024: 0.4 to 2.5.
const FACTOR_Q10: core::ops::RangeInclusive<u64> = 410..=2_560;

/// sin of the four midpoints of a quarter period (11.25°, 33.75°, …), in 1/1024: the mean over
/// them is the mean over the half-cycle.
const ENVELOPE_Q10: [u64; 4] = [200, 569, 851, 1_004];

/// Power control's memory.
#[derive(Clone, Debug)]
pub struct PowerControl {
    factor_q10: u64,
}

impl Default for PowerControl {
    fn default() -> Self {
        Self { factor_q10: 1_024 }
    }
}

/// Mean power of a half-cycle in milliwatt that the lookup predicts at a frequency, or `None`
/// where the tank would come too close to resonance or the current too high.
///
/// At each point of the envelope the amplitude is the fixed point of I = V1/|Z(f, I)| with
/// V1 = 2/π of the bus (a 0..V_bus square wave). R and L fall with I, so the iteration rises towards
/// it from the last point's current; eight rounds leave less than 1 %.
pub fn predict_mw(lookup: &RlLookup, f_sw_hz: u32, bus_peak_dv: u16) -> Option<u64> {
    let v1_peak_mv = u64::from(bus_peak_dv) * 100 * 6_366 / 10_000;
    let mut total_mw = 0;
    let mut i_ma = 0;
    for sine in ENVELOPE_Q10 {
        let v1_mv = v1_peak_mv * sine / 1_024;
        let mut tank = tank_at(lookup, f_sw_hz, i_ma);
        for _ in 0..8 {
            i_ma = v1_mv * 1_000 / tank.z_mohm().max(1);
            tank = tank_at(lookup, f_sw_hz, i_ma);
        }
        if i_ma > I_CREST_MAX_MA || !tank.is_above_resonance(RESONANCE_MARGIN_PERCENT) {
            return None;
        }
        // ½ I² R: mA² · mΩ = 1e-9 W.
        total_mw += i_ma * i_ma * tank.r_mohm.max(0) as u64 / 2_000_000;
    }
    Some(total_mw / ENVELOPE_Q10.len() as u64)
}

fn tank_at(lookup: &RlLookup, f_sw_hz: u32, i_ma: u64) -> Tank {
    let (r, l) = lookup.interpolate(f_sw_hz, i_ma.min(u64::from(u32::MAX)) as u32);
    Tank::new(f_sw_hz, r, l)
}

/// The smallest step that a measured error asks for, in hertz: above resonance P ∝ f^−2 to f^−6, so a
/// sixth of the relative error never overshoots.
fn trim_hz(f_sw_hz: u32, error_mw: u64, asked_mw: u64) -> u32 {
    let trim = u64::from(f_sw_hz) * error_mw / (6 * asked_mw.max(1));
    trim.min(u64::from(STEP_UP_HZ)) as u32
}

/// The largest step, in smallest ones: half of the relative error, for P ∝ f^−2. What the lookup
/// solves for counts between the two.
const MAX_OF_TRIM: u32 = 3;

impl PowerControl {
    /// The frequency of the grid for the next half-cycle. `asked_mw` above zero, the inverter running.
    ///
    /// The smallest step asked for is f/300, more than half of the grid's f²/22.3 MHz at every
    /// frequency, so rounding never swallows it.
    pub fn next_frequency(&mut self, summary: &Summary, asked_mw: u64, lookup: &RlLookup) -> u32 {
        pwm::nearest_hz(self.wanted_frequency(summary, asked_mw, lookup))
    }

    fn wanted_frequency(&mut self, summary: &Summary, asked_mw: u64, lookup: &RlLookup) -> u32 {
        let now = summary.f_sw_hz.clamp(F_SW_MIN_HZ, F_SW_MAX_HZ);
        if let Some(predicted) = predict_mw(lookup, now, summary.bus_peak_dv).filter(|&p| p > 0) {
            let ratio = (u64::from(summary.power_mw) << 10) / predicted;
            // Half of the way at once: the measurement is of this frequency, the use of another.
            self.factor_q10 = (self.factor_q10 + ratio) / 2;
            self.factor_q10 = self
                .factor_q10
                .clamp(*FACTOR_Q10.start(), *FACTOR_Q10.end());
        }
        let measured = Tank::new(now, summary.r, summary.l);
        if summary.i_crest_ma > 0 && !measured.is_above_resonance(RESONANCE_MARGIN_PERCENT / 2) {
            // The load is not what the lookup says: leave resonance first.
            return (now + STEP_UP_HZ).min(F_SW_MAX_HZ);
        }
        let error = u64::from(summary.power_mw).abs_diff(asked_mw);
        if error * 100 <= asked_mw * u64::from(DEAD_BAND_PERCENT) {
            return now;
        }
        let solved = self.solve(asked_mw, summary.bus_peak_dv, lookup);
        let error = i64::from(summary.power_mw) - asked_mw as i64;
        let trim = trim_hz(now, error.unsigned_abs(), asked_mw);
        let next = if error > 0 {
            solved.clamp(now + trim, now + MAX_OF_TRIM * trim)
        } else if measured.is_above_resonance(RESONANCE_MARGIN_PERCENT) {
            solved.clamp(
                now.saturating_sub(MAX_OF_TRIM * trim),
                now.saturating_sub(trim),
            )
        } else {
            // More power lies below the margin.
            now
        };
        next.clamp(now.saturating_sub(STEP_DOWN_HZ), now + STEP_UP_HZ)
            .clamp(F_SW_MIN_HZ, F_SW_MAX_HZ)
    }

    /// The lowest frequency whose predicted power is not above the asked one, to 50 Hz.
    fn solve(&self, asked_mw: u64, bus_peak_dv: u16, lookup: &RlLookup) -> u32 {
        let (mut low, mut high) = (F_SW_MIN_HZ, F_SW_MAX_HZ);
        while high - low > 50 {
            let middle = low.midpoint(high);
            match predict_mw(lookup, middle, bus_peak_dv) {
                Some(mw) if (mw * self.factor_q10) >> 10 <= asked_mw => high = middle,
                _ => low = middle,
            }
        }
        high
    }

    /// Forgets the learnt factor, for another load.
    pub fn restart(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use ihd_shared::lookup::prior::prior;

    /// The oracle: the same physics in f64, the envelope integrated finely, R and L from the
    /// prior's own law.
    fn oracle_w(f_hz: f64, bus_v: f64) -> f64 {
        let steps = 400;
        let mut sum = 0.0;
        for k in 0..steps {
            let v1 = 2.0 / PI * bus_v * (PI * (f64::from(k) + 0.5) / f64::from(steps)).sin();
            let mut i = 0.0;
            let mut r = 0.0;
            for _ in 0..60 {
                let x = f_hz / 45e3;
                r = (3.0 + 4.0 / (1.0 + i / 9.0)) * x.sqrt();
                let l = (20.5 + 18.0 / (1.0 + i / 10.0)) * 1e-6 * x.powf(-0.3);
                let net = 2.0 * PI * f_hz * l - 1.0 / (2.0 * PI * f_hz * 1080e-9);
                i = 0.5 * (i + v1 / r.hypot(net));
            }
            sum += 0.5 * i * i * r;
        }
        sum / f64::from(steps)
    }

    #[test]
    fn prediction_follows_the_f64_oracle() {
        for f in [42_000, 50_000, 60_000, 80_000] {
            let mw = predict_mw(&prior(), f, 3_253).unwrap() as f64;
            let oracle = oracle_w(f64::from(f), 325.3) * 1e3;
            assert!((mw / oracle - 1.0).abs() < 0.01, "{f}: {mw} {oracle}");
        }
    }

    #[test]
    fn no_power_is_predicted_near_resonance() {
        assert_eq!(predict_mw(&prior(), 31_000, 3_253), None);
    }

    /// A plant whose power is the prediction times a factor the control does not know.
    fn settle(asked_w: u64, plant: f64) -> (u32, f64) {
        settle_on(&prior(), &prior(), asked_w, plant)
    }

    fn settle_on(load: &RlLookup, lookup: &RlLookup, asked_w: u64, plant: f64) -> (u32, f64) {
        let mut control = PowerControl::default();
        let mut f = pwm::HIGHEST_HZ;
        let mut power = 0.0;
        for _ in 0..60 {
            power = predict_mw(load, f, 3_253).map_or(0.0, |mw| mw as f64 * plant);
            let (r, l) = load.interpolate(f, 30_000);
            let summary = Summary {
                f_sw_hz: f,
                power_mw: power as u32,
                bus_peak_dv: 3_253,
                i_crest_ma: 30_000,
                r,
                l,
                ..Summary::default()
            };
            let next = control.next_frequency(&summary, asked_w * 1_000, lookup);
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
        for asked in [700, 1_000, 1_500, 2_000] {
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
            predict_mw(&prior(), f, 3_253).is_some(),
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
        let summary = Summary {
            f_sw_hz: 40_000,
            power_mw: 100_000,
            bus_peak_dv: 3_253,
            i_crest_ma: 20_000,
            r: ihd_shared::units::MicroOhm(3_000_000),
            l: ihd_shared::units::PicoHenry(15_000_000),
            ..Summary::default()
        };
        let next = control.next_frequency(&summary, 2_000_000, &prior());
        assert_eq!(next, pwm::nearest_hz(48_000));
    }
}
