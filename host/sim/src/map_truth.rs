//! Truth of a map: R and L of a load at the lookup's knots, in the range that the hob reaches.
//!
//! A knot's frequency is reached if the firmware would use it:
//! - within its range of frequencies,
//! - at the full mains of 230 V within the limits of power control ([`Bounds`]: crest current, coil voltage, distance from
//!   resonance, soft switching),
//! - with a mean power of at most the rated one (half of it for a load that the firmware classifies as a small pot),
//! - and with a pot that it heats at all.
//!
//! The half-cycle's current passes every amplitude from zero to its crest, so the cells up to the crest are reached; bursts make
//! the lower powers.
//!
//! A law is evaluated directly. For the field model the half-bridge runs through a mains half-cycle in the time domain: R and L of
//! the fundamental come from the waveform, harmonics of the current included, as [`crate::recording`] takes its truth; the
//! describing function is not used.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, TAU};

use ihd_firmware::control::pot::classify;
use ihd_firmware::control::power::bounds::Bounds;
use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::drive::pwm::{DEAD_TIME_NS, MAX_HZ};
use ihd_firmware::limits::SMALL_POT_PERCENT;
use ihd_firmware::sampling::half_cycle::{CurrentCrest, HalfCycle};
use ihd_shared::hob::{
    BUS_PEAK_V, F_SW_MAX_HZ, F_SW_MIN_HZ, NODE_CAPACITANCE_NF, RATED_POWER_W,
    RESONANCE_CAPACITANCE_NF,
};
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, current_a, frequency_hz};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::messages::{Limit, Pot as Class};
use ihd_signal::Load;
use ihd_signal::truth::{MapTruth, PeriodTruth};

use crate::inverter::bridge::SwitchedHalfBridge;
use crate::inverter::bus::Bus;
use crate::inverter::harmonic_analyser::HarmonicAnalyser;
use crate::inverter::load::Warmth;
use crate::inverter::supply::SupplyParts;
use crate::inverter::{Inverter, InverterError, STEPS_PER_PERIOD};
use crate::mains::SimulatedMains;
use crate::pot::SimulatedPot;
use crate::recording::prepared::PreparedLoad;
use crate::recording::settings::LoadKind;
use ihd_shared::hob::WINDING_R_OHM;

/// Resonance capacitor in farad.
const C_RES_F: f64 = RESONANCE_CAPACITANCE_NF as f64 * 1e-9;

/// Crest of the full mains, in decivolt.
const BUS_PEAK_DV: u16 = (BUS_PEAK_V * 10.0) as u16;

/// Number of points of a law's curve: linear interpolation is off by 1e-5 at most.
const LAW_POINTS: usize = 400;

/// Upper limit of the crest current, in ampere.
const BEYOND_A: f64 = 200.0;

/// Mains frequency of the half-cycle, in hertz. The tank follows within some periods: 50 or 60 is the same.
const MAINS_HZ: f64 = 50.0;

/// Number of switching periods from rest that are dropped: the tank's quality is below 8 for every pot that is heated.
const SETTLING_PERIODS: usize = 12;

/// Bus voltage for the limit of zero current, in volt: it drives some 20 mA, at which the steel of any pot has its initial
/// permeability within 0.3 %.
const SMALL_SIGNAL_V: f64 = 0.2;

/// Number of switching periods under that voltage until its current repeats.
const SMALL_SIGNAL_PERIODS: usize = 80;

/// Number of bisections in the search for a power: 0.1 % of the frequency remains.
const POWER_STEPS: usize = 10;

/// Load whose truth is known at every frequency and current.
#[derive(Clone, Debug)]
pub struct TrueLoad {
    prepared: PreparedLoad,
    pot: SimulatedPot,
    winding_r_ohm: f64,
    /// Parts that feed the half-bridge of a field model.
    supply: SupplyParts,
    /// Temperature in °C to which a law is heated after it was made.
    warm_c: Option<f64>,
}

/// R and L over the current's amplitude at one switching frequency, from zero current to the crest at full mains.
#[derive(Clone, Debug, PartialEq)]
pub struct TrueCurve {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Amplitudes of the fundamental in ampere, rising from 0, with R and L there.
    pub points: Vec<(f64, Load)>,
    /// Mean power over the half-cycle in watt.
    pub power_w: f64,
}

impl TrueCurve {
    /// Amplitude of the fundamental at the crest of the mains, in ampere.
    pub fn crest_a(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.0)
    }

    /// R and L at an amplitude in ampere; `None` beyond the crest.
    pub fn at(&self, i_a: f64) -> Option<Load> {
        between(&self.points, i_a)
    }

    /// Highest power in watt at which the firmware heats this load; `None` if it is no pot for the firmware.
    fn rated_w(&self, summary: &HalfCycle) -> Option<f64> {
        let rated_w = f64::from(RATED_POWER_W);
        match classify(summary, Class::Unknown) {
            Class::Ferromagnetic => Some(rated_w),
            Class::Small => Some(rated_w * f64::from(SMALL_POT_PERCENT) * 1e-2),
            _ => None,
        }
    }

    /// Half-cycle that the firmware would compute for this half-cycle.
    fn summary(&self) -> HalfCycle {
        let (i_a, load) = self.points.last().copied().unwrap_or_default();
        HalfCycle {
            f_sw_hz: self.f_sw_hz.round() as u32,
            crest: CurrentCrest {
                r: MicroOhm((load.r_ohm * 1e6) as i32),
                l: PicoHenry((load.l_h * 1e12) as i32),
                i_ma: (i_a * 1e3) as u32,
                ..CurrentCrest::default()
            },
            power_mw: (self.power_w * 1e3) as u32,
            bus_peak_dv: BUS_PEAK_DV,
            ..HalfCycle::default()
        }
    }

    /// Checks if power control may use this frequency at the full mains; see the module.
    pub fn reach(&self) -> Reach {
        let summary = self.summary();
        let Some(rated_w) = self.rated_w(&summary) else {
            return Reach::NoPot;
        };
        let bounds = Bounds::new(&summary, BUS_PEAK_DV);
        let in_range = (f64::from(F_SW_MIN_HZ)..=f64::from(F_SW_MAX_HZ)).contains(&self.f_sw_hz);
        let limit = bounds.limit_at(summary.f_sw_hz);
        if in_range && limit == Limit::None && self.power_w <= rated_w {
            Reach::Used
        } else {
            Reach::Beyond
        }
    }
}

/// Firmware's use of a load at a frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// The firmware heats here.
    Used,
    /// A limit forbids it, or the rated power is exceeded; also for lower frequencies.
    Beyond,
    /// The firmware classifies the load as no pot that it can heat.
    NoPot,
}

impl TrueLoad {
    /// Prepares the load of the simulated hob. `warm_c`: present temperature of a pot that warms up, in °C.
    ///
    /// # Errors
    /// [`InverterError::Field`] if there is no model of that pot.
    pub fn new(
        kind: LoadKind,
        pot: &SimulatedPot,
        warm_c: Option<f64>,
    ) -> Result<Self, InverterError> {
        // The field has the hot metal from the start; a law is heated like in the simulated hob.
        let (pot, warm_c) = match (kind, warm_c) {
            (LoadKind::Field, Some(temperature_c)) => {
                let hot = SimulatedPot {
                    temperature_c,
                    ..*pot
                };
                (hot, None)
            }
            _ => (*pot, warm_c),
        };
        let winding_r_ohm = match kind {
            LoadKind::Behavioural => 0.0,
            LoadKind::Field | LoadKind::Surrogate => WINDING_R_OHM,
        };
        Ok(Self {
            prepared: PreparedLoad::new(kind, &pot, winding_r_ohm)?,
            pot,
            winding_r_ohm,
            supply: SupplyParts::NONE,
            warm_c,
        })
    }

    /// Returns the load at a bus with these parts. Their ripple changes the current's harmonics, and with them up to .4 % of R of
    /// a field model.
    #[must_use]
    pub fn fed_by(mut self, supply: SupplyParts) -> Self {
        self.supply = supply;
        self
    }

    /// R and L over current at a frequency in hertz. A law takes no time, the field model half a second and four times that off
    /// centre.
    ///
    /// # Errors
    /// [`InverterError::Field`] if there is no model at that frequency.
    pub fn curve(&self, f_sw_hz: f64) -> Result<TrueCurve, InverterError> {
        match &self.prepared {
            PreparedLoad::Field(_) => self.waveform(f_sw_hz),
            PreparedLoad::Surrogate(_) | PreparedLoad::Behavioural(_) => self.law(f_sw_hz),
        }
    }

    /// Truth at the lookup's knots; `progress` is called with the share done, 0 to 1.
    ///
    /// # Errors
    /// Any error of [`TrueLoad::curve`].
    pub fn map(&self, progress: &mut dyn FnMut(f64)) -> Result<MapTruth, InverterError> {
        let mut truth = MapTruth::UNREACHED;
        for f in (0..FREQUENCIES).rev() {
            let curve = self.curve(frequency_hz(f))?;
            match curve.reach() {
                Reach::Beyond => break,
                Reach::NoPot => {}
                Reach::Used => {
                    for i in 0..CURRENTS {
                        truth.cells[f][i] = curve.at(current_a(i));
                    }
                }
            }
            progress(1.0 - f as f64 / FREQUENCIES as f64);
        }
        progress(1.0);
        Ok(truth)
    }

    /// Curve at which the hob heats with a mean power in watt at full mains: the lowest frequency that takes no more and keeps the
    /// firmware's limits. If the highest frequency exceeds the power, the hob uses bursts at that frequency.
    ///
    /// # Errors
    /// Any error of [`TrueLoad::curve`].
    pub fn heated_with(&self, power_w: f64) -> Result<TrueCurve, InverterError> {
        let mut high = self.curve(f64::from(MAX_HZ))?;
        if high.power_w > power_w {
            return Ok(high);
        }
        let mut low_hz = f64::from(F_SW_MIN_HZ);
        for _ in 0..POWER_STEPS {
            let middle = self.curve((low_hz * high.f_sw_hz).sqrt())?;
            if middle.reach() == Reach::Beyond || middle.power_w > power_w {
                low_hz = middle.f_sw_hz;
            } else {
                high = middle;
            }
        }
        Ok(high)
    }

    fn law(&self, f_sw_hz: f64) -> Result<TrueCurve, InverterError> {
        let mut state = self.prepared.start(f_sw_hz, STEPS_PER_PERIOD, None)?;
        if let (Some(warm_c), Some(base)) = (self.warm_c, self.pot.base) {
            let warmth = Warmth::from_temperatures(
                base,
                (self.pot.temperature_c, warm_c),
                self.winding_r_ohm,
            );
            if let Some(law) = self.prepared.law(warmth.law_hz(f_sw_hz)) {
                state.set_hot_law(law, warmth);
            }
        }
        let at = |i_a: f64| {
            let (r_ohm, l_h) = state.law_at(i_a).unwrap_or((0.0, 0.0));
            Load { r_ohm, l_h }
        };
        let omega = TAU * f_sw_hz;
        // Bus voltage whose fundamental, 2/π of it, drives a current.
        let bus_v = |i_a: f64| {
            let z = at(i_a);
            let x = omega * z.l_h - 1.0 / (omega * C_RES_F);
            i_a * (z.r_ohm * z.r_ohm + x * x).sqrt() / FRAC_2_PI
        };
        let (mut crest_a, mut beyond_a) = (0.0, BEYOND_A);
        for _ in 0..50 {
            let middle_a = 0.5 * (crest_a + beyond_a);
            if bus_v(middle_a) < BUS_PEAK_V {
                crest_a = middle_a;
            } else {
                beyond_a = middle_a;
            }
        }
        let points: Vec<(f64, Load)> = (0..=LAW_POINTS)
            .map(|k| {
                let x = k as f64 / LAW_POINTS as f64;
                // Denser where R and L bend.
                let i_a = crest_a * x * x;
                (i_a, at(i_a))
            })
            .collect();
        // Mean of R i²/2 over the mains' angle, which the bus voltage gives for each current.
        let angle = |i_a: f64| libm::asin((bus_v(i_a) / BUS_PEAK_V).clamp(0.0, 1.0));
        let heat = |(i_a, z): (f64, Load)| 0.5 * z.r_ohm * i_a * i_a;
        let power_w: f64 = points
            .windows(2)
            .map(|w| (angle(w[1].0) - angle(w[0].0)) * 0.5 * (heat(w[0]) + heat(w[1])))
            .sum();
        Ok(TrueCurve {
            f_sw_hz,
            points,
            power_w: power_w / FRAC_PI_2,
        })
    }

    /// The half-bridge in the time domain, from rest at a zero crossing to the next.
    fn waveform(&self, f_sw_hz: f64) -> Result<TrueCurve, InverterError> {
        let mains = SimulatedMains::new(MAINS_HZ);
        let periods = (mains.half_cycle_s() * f_sw_hz) as usize;
        let bus = Bus::new(mains, self.supply, 0.0)?;
        let (truth, power_w) = self.run(f_sw_hz, bus, periods)?;
        let truth = &truth[SETTLING_PERIODS.min(truth.len())..];
        let top = (0..truth.len()).max_by(|&a, &b| truth[a].i_a.total_cmp(&truth[b].i_a));
        let (rising, falling) = truth.split_at(top.map_or(0, |k| k + 1));
        let rising = monotone(rising.iter());
        let falling = monotone(falling.iter().rev());
        let mut points = vec![(0.0, self.small_signal(f_sw_hz)?)];
        // Mean of both flanks, as in a window's load curve.
        points.extend(rising.iter().map(|&(i_a, up)| {
            let both = between(&falling, i_a).map_or(up, |down| Load {
                r_ohm: 0.5 * (up.r_ohm + down.r_ohm),
                l_h: 0.5 * (up.l_h + down.l_h),
            });
            (i_a, both)
        }));
        Ok(TrueCurve {
            f_sw_hz,
            points,
            power_w,
        })
    }

    /// R and L in the limit of zero current.
    fn small_signal(&self, f_sw_hz: f64) -> Result<Load, InverterError> {
        let mut bus = Bus::new(SimulatedMains::new(MAINS_HZ), SupplyParts::NONE, 0.0)?;
        bus.set_supply(SMALL_SIGNAL_V);
        let (truth, _) = self.run(f_sw_hz, bus, SMALL_SIGNAL_PERIODS)?;
        Ok(truth.last().map(load_of).unwrap_or_default())
    }

    /// Runs the half-bridge from rest for several periods: returns the truth between each two of them, and the mean power in watt.
    fn run(
        &self,
        f_sw_hz: f64,
        bus: Bus,
        periods: usize,
    ) -> Result<(Vec<PeriodTruth>, f64), InverterError> {
        let bridge = SwitchedHalfBridge::with_node(
            f64::from(DEAD_TIME_NS) * 1e-9,
            f64::from(NODE_CAPACITANCE_NF) * 1e-9,
        )?;
        let load = self.prepared.start(f_sw_hz, STEPS_PER_PERIOD, None)?;
        let mut inverter = Inverter::new(bus, bridge, load, f_sw_hz, STEPS_PER_PERIOD, 0.0);
        let mut analyser = HarmonicAnalyser::new(STEPS_PER_PERIOD);
        let mut before = None;
        let mut truth = Vec::with_capacity(periods);
        for _ in 0..periods {
            let start = inverter.instant();
            analyser.start(start.i_a);
            for n in 1..=STEPS_PER_PERIOD {
                let now = inverter.advance(Bridge::Switching);
                analyser.push_mean(n, now.coil_mean_v, now.i_a);
            }
            let sums = analyser.sums();
            if let Some(before) = before.replace(sums.clone()) {
                truth.push(before.across(sums, start.t_s, f_sw_hz));
            }
        }
        let power_w = inverter.load_energy_j() / (periods as f64 / f_sw_hz);
        Ok((truth, power_w))
    }
}

fn load_of(truth: &PeriodTruth) -> Load {
    Load {
        r_ohm: truth.r_ohm[0],
        l_h: truth.l_h[0],
    }
}

/// Points of a flank with monotonically rising current.
fn monotone<'a>(truth: impl Iterator<Item = &'a PeriodTruth>) -> Vec<(f64, Load)> {
    let mut points: Vec<(f64, Load)> = Vec::new();
    for t in truth {
        if t.i_a > points.last().map_or(0.0, |p| p.0) {
            points.push((t.i_a, load_of(t)));
        }
    }
    points
}

/// Interpolates linearly between the points; `None` outside them.
fn between(points: &[(f64, Load)], i_a: f64) -> Option<Load> {
    let above = points.partition_point(|p| p.0 < i_a);
    let (i_1, z_1) = *points.get(above)?;
    let Some(&(i_0, z_0)) = above.checked_sub(1).and_then(|k| points.get(k)) else {
        return (i_a == i_1).then_some(z_1);
    };
    let w = (i_a - i_0) / (i_1 - i_0);
    Some(Load {
        r_ohm: z_0.r_ohm + w * (z_1.r_ohm - z_0.r_ohm),
        l_h: z_0.l_h + w * (z_1.l_h - z_0.l_h),
    })
}

#[cfg(test)]
mod tests;
