//! The DC bus between rectifier and half-bridge.

use super::InverterError;
use super::supply::SupplyParts;
use crate::front_end::MAINS_CHAIN_OHM;
use crate::low_pass::without_decayed;
use crate::mains::SimulatedMains;

/// Period in seconds at which the mains is computed, linear in between: the error is (ω dt)²/8 = 5e-8 of the peak.
const MAINS_STEP_S: f64 = 2e-6;

/// Bus voltage over time. A bench supply determines it alone. Without capacitance it is the rectified mains; with it, the rectifier
/// charges the capacitor through line and choke, and the inverter discharges it.
#[derive(Clone, Debug, PartialEq)]
pub struct Bus {
    mains: SimulatedMains,
    parts: SupplyParts,
    per: Reciprocals,
    /// DC voltage of a bench supply in place of the rectifier, in volt.
    supply_v: Option<f64>,
    v: f64,
    line: Line,
    /// Longest step of line and rectifier while the bridge's own are shorter, in seconds.
    line_step_s: f64,
    /// Number of the present piece of the mains, and the voltage at its ends.
    piece: (f64, f64, f64),
}

/// Share of a radian of the fastest ringing of line, choke and capacitors that a step of the line may last: 0.29 µs with the
/// schematic's parts. The error of the ringing's period is (this)²/24.
const LINE_STEP_RAD: f64 = 0.1;

/// Resistance that discharges C1 behind an open line, in ohm: its own 2 × 330 kohm beside one chain of the mains' amplifier, whose
/// current comes back through a lower diode of the rectifier (docs/schematic.py).
const TERMINAL_OHM: f64 = 1.0 / (1.0 / 660e3 + 1.0 / MAINS_CHAIN_OHM);

/// Effect of currents on the DC link in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Charging {
    /// Longest number of steps for which the current of the rectifier may be held.
    pub steps: usize,
    /// Change of the voltage in a step for each ampere, in volt.
    pub volt_per_ampere: f64,
    /// Conductance across the link, in siemens.
    pub discharge_s: f64,
}

/// State of a line with inductance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Line {
    /// Current of the line, in ampere.
    line_a: f64,
    /// Voltage between the mains terminals, at C1, in volt.
    terminal_v: f64,
    /// Current through choke and rectifier, in ampere; with the sign of the half-wave that conducts.
    rectifier_a: f64,
    /// Half of the step before, by which the currents are behind, in seconds.
    behind_s: f64,
}

/// Reciprocals of the parts' values, as a division at every step is slow.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reciprocals {
    line_l: f64,
    choke_l: f64,
    terminal_c: f64,
    link_c: f64,
    discharge_r: f64,
}

impl Reciprocals {
    fn from_parts(parts: &SupplyParts) -> Self {
        Self {
            line_l: parts.line_l_h.recip(),
            choke_l: parts.choke_l_h.recip(),
            terminal_c: parts.terminal_capacitance_f.recip(),
            link_c: parts.link_capacitance_f.recip(),
            discharge_r: parts.discharge_ohm.recip(),
        }
    }
}

/// Longest step of the line with these parts, in seconds.
fn line_step_s(per: &Reciprocals) -> f64 {
    let choke = per.choke_l * (per.terminal_c + per.link_c);
    LINE_STEP_RAD / libm::sqrt(choke + per.line_l * per.terminal_c)
}

impl Line {
    /// Advances by `dt_s` to a mains of `mains_v`, `None` behind an open line, beside a DC link of `link_v`: currents to the middle of the step, then the
    /// terminal's voltage by them to its end. Neither damps nor excites, also where steps of different lengths follow each other; the
    /// error of a ringing of period T is (2π dt/T)²/24 of the period.
    fn advance(
        &mut self,
        parts: &SupplyParts,
        per: &Reciprocals,
        (mains_v, link_v): (Option<f64>, f64),
        dt_s: f64,
    ) {
        let currents_s = self.behind_s + 0.5 * dt_s;
        self.behind_s = 0.5 * dt_s;
        let mut terminal_a = 0.0;
        match mains_v {
            Some(mains_v) => {
                let drop_v = parts.line_r_ohm * self.line_a;
                self.line_a += currents_s * per.line_l * (mains_v - drop_v - self.terminal_v);
            }
            None => {
                self.line_a = 0.0;
                terminal_a = self.terminal_v / TERMINAL_OHM;
            }
        }
        let sign = match self.rectifier_a {
            0.0 => self.terminal_v.signum(),
            i => i.signum(),
        };
        let conducting_a = self.rectifier_a.abs();
        let across_v = sign * self.terminal_v
            - parts.rectifier_v
            - link_v
            - parts.rectifier_r_ohm * conducting_a;
        // A current that would reverse ends.
        self.rectifier_a = sign * (conducting_a + currents_s * per.choke_l * across_v).max(0.0);
        self.terminal_v += dt_s * per.terminal_c * (self.line_a - self.rectifier_a - terminal_a);
    }
}

impl Bus {
    /// Starts at the mains voltage of time `t_s`, without current.
    ///
    /// # Errors
    /// For parts that are out of range.
    pub fn new(mains: SimulatedMains, parts: SupplyParts, t_s: f64) -> Result<Self, InverterError> {
        parts.check()?;
        let per = Reciprocals::from_parts(&parts);
        Ok(Self {
            mains,
            parts,
            per,
            line_step_s: line_step_s(&per),
            supply_v: None,
            v: mains.bus_v(t_s),
            line: Line {
                terminal_v: mains.mains_v(t_s),
                ..Line::default()
            },
            piece: (-1.0, 0.0, 0.0),
        })
    }

    /// Parts that feed it.
    pub fn parts(&self) -> &SupplyParts {
        &self.parts
    }

    /// Feeds the bus from a bench supply of this voltage from now on, instead of the rectifier.
    pub fn set_supply(&mut self, supply_v: f64) {
        self.supply_v = Some(supply_v);
        self.v = supply_v;
    }

    /// Voltage of the bench supply in volt, if there is one.
    pub fn supply_v(&self) -> Option<f64> {
        self.supply_v
    }

    /// The mains.
    pub fn mains(&self) -> SimulatedMains {
        self.mains
    }

    /// Replaces the mains.
    pub fn set_mains(&mut self, mains: SimulatedMains) {
        self.mains = mains;
        self.piece.0 = -1.0;
    }

    /// Bus voltage now, in volt.
    pub fn v(&self) -> f64 {
        self.v
    }

    /// Voltage between the mains terminals at `t_s`, now, in volt: the mains behind its line. With a bench supply that of the
    /// detector's transformer.
    pub fn terminal_v(&self, t_s: f64) -> f64 {
        if self.has_line() {
            self.line.terminal_v
        } else {
            match self.mains.is_open {
                true => 0.0,
                false => self.mains.mains_v(t_s),
            }
        }
    }

    /// Returns `true` if the bus holds its voltage while the mains passes its zero.
    pub(super) fn holds(&self) -> bool {
        self.supply_v.is_some() || self.parts.link_capacitance_f > 0.0
    }

    /// Returns `true` if line and choke have an effect.
    fn has_line(&self) -> bool {
        self.parts.line_l_h > 0.0 && self.parts.link_capacitance_f > 0.0 && self.supply_v.is_none()
    }

    /// Advances by `dt_s` to time `t_s`, while the bridge draws `i_a`; returns the new voltage.
    pub fn advance(&mut self, t_s: f64, dt_s: f64, i_a: f64) -> f64 {
        self.v = match self.supply_v {
            Some(supply_v) => supply_v,
            None if self.parts.link_capacitance_f == 0.0 => self.line_v(t_s).unwrap_or(0.0).abs(),
            None => self.charge(t_s, dt_s, i_a),
        };
        self.v
    }

    /// Effect of currents on the link in steps of `dt_s`; `None` where the link does not integrate a current.
    pub(super) fn charging(&self, dt_s: f64) -> Option<Charging> {
        if self.supply_v.is_some() {
            return Some(Charging {
                steps: usize::MAX,
                volt_per_ampere: 0.0,
                discharge_s: 0.0,
            });
        }
        self.has_line().then(|| Charging {
            steps: 1 + (self.line_step_s / dt_s) as usize,
            volt_per_ampere: dt_s * self.per.link_c,
            discharge_s: self.per.discharge_r,
        })
    }

    /// Advances line and rectifier by `over_s` from `t_s` on, beside the present voltage of the link, which follows by [`Charging`] and
    /// [`Bus::set_v`]. Returns the current of the rectifier, in ampere.
    pub(super) fn hold(&mut self, t_s: f64, over_s: f64) -> f64 {
        if self.supply_v.is_some() {
            return 0.0;
        }
        let voltages = (self.line_v(t_s), self.v);
        self.line.advance(&self.parts, &self.per, voltages, over_s);
        self.line.rectifier_a.abs()
    }

    /// State of the line.
    pub(super) fn line(&self) -> Line {
        self.line
    }

    /// Repeats [`Bus::hold`] from `line` on, over a shorter time.
    pub(super) fn hold_again(&mut self, line: Line, t_s: f64, over_s: f64) {
        self.line = line;
        self.hold(t_s, over_s);
    }

    /// Ends currents and voltages that have decayed since the mains left.
    pub(super) fn end_decay(&mut self) {
        let line = &mut self.line;
        for quantity in [&mut line.line_a, &mut line.terminal_v, &mut self.v] {
            *quantity = without_decayed(*quantity);
        }
    }

    /// Sets the voltage of the link, in volt.
    pub(super) fn set_v(&mut self, v: f64) {
        self.v = v;
    }

    /// Voltage of the capacitor after a step. Without an inductance the old voltage decides whether the diodes conduct, and the
    /// rest is implicit: stable for any step.
    fn charge(&mut self, t_s: f64, dt_s: f64, i_a: f64) -> f64 {
        let line_v = self.line_v(t_s);
        let parts = &self.parts;
        let rate = dt_s * self.per.link_c;
        let drawn_a = i_a + self.v * self.per.discharge_r;
        let v = if parts.line_l_h > 0.0 {
            let voltages = (line_v, self.v);
            self.line.advance(parts, &self.per, voltages, dt_s);
            self.v + rate * (self.line.rectifier_a.abs() - drawn_a)
        } else {
            let rectified_v = line_v.unwrap_or(0.0).abs() - parts.rectifier_v;
            let g = if rectified_v > self.v {
                rate / (parts.line_r_ohm + parts.rectifier_r_ohm)
            } else {
                0.0
            };
            (self.v + g * rectified_v - rate * drawn_a) / (1.0 + g)
        };
        // The lower diodes keep the bus from going negative.
        v.max(0.0)
    }

    /// Voltage that feeds the line, in volt; `None` while it is open.
    fn line_v(&mut self, t_s: f64) -> Option<f64> {
        (!self.mains.is_open).then(|| self.mains_v(t_s))
    }

    /// Mains voltage, in volt.
    fn mains_v(&mut self, t_s: f64) -> f64 {
        let at = t_s / MAINS_STEP_S;
        let (before, _, end_v) = self.piece;
        // Faster than computing the floor at every step.
        if !(before..before + 1.0).contains(&at) {
            let number = at.floor();
            let v = |n: f64| self.mains.mains_v(n * MAINS_STEP_S);
            let from_v = match number == before + 1.0 && before >= 0.0 {
                true => end_v,
                false => v(number),
            };
            self.piece = (number, from_v, v(number + 1.0));
        }
        let (number, from, to) = self.piece;
        from + (at - number) * (to - from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_capacitance_it_is_the_rectified_mains() {
        let mains = SimulatedMains::new(50.0);
        let mut bus = Bus::new(mains, SupplyParts::NONE, 0.0).unwrap();
        for t_s in [3e-3, 3.0001e-3, 9.9999e-3, 10.0001e-3] {
            let v = bus.advance(t_s, 20e-9, 40.0);
            assert!((v - mains.bus_v(t_s)).abs() < 1e-6 * mains.peak_v, "{t_s}");
        }
    }

    #[test]
    fn a_bench_supply_is_the_bus_whatever_the_mains() {
        let mut bus = Bus::new(SimulatedMains::new(50.0), SupplyParts::NONE, 0.0).unwrap();
        bus.set_supply(40.0);
        assert_eq!(bus.v(), 40.0);
        for t_s in [0.0, 3e-3, 10e-3] {
            assert_eq!(bus.advance(t_s, 20e-9, 30.0), 40.0);
        }
    }

    #[test]
    fn a_capacitor_holds_the_bus_up_at_the_zero_crossing() {
        // 0.1 A from 10 µF: 10 V a millisecond. It leaves the sine where ω V̂ |cos ωt| is that,
        // and falls in a straight line until the zero crossing.
        let mut bus = Bus::new(SimulatedMains::new(50.0), SupplyParts::stiff(10e-6), 5e-3).unwrap();
        for n in 1..=5000 {
            bus.advance(5e-3 + f64::from(n) * 1e-6, 1e-6, 0.1);
        }
        let (peak_v, omega) = (
            SimulatedMains::new(50.0).peak_v,
            std::f64::consts::TAU * 50.0,
        );
        let angle = std::f64::consts::PI - (10e3 / (peak_v * omega)).acos();
        let expected_v = peak_v * angle.sin() - 10e3 * (10e-3 - angle / omega);
        assert!(
            (bus.v() - expected_v).abs() < 1.0,
            "{} {expected_v}",
            bus.v()
        );
    }

    #[test]
    fn refuses_an_impossible_capacitor() {
        let e = Bus::new(SimulatedMains::new(50.0), SupplyParts::stiff(-1.0), 0.0).unwrap_err();
        assert!(e.to_string().contains("bus_capacitance_f"));
    }

    /// Energy of the line's current goes into the capacitor when nothing draws any more: at the crest
    /// V̂ + I√(L/C), less what the line's resistance takes.
    #[test]
    fn a_line_current_that_is_cut_off_charges_the_link() {
        let parts = SupplyParts {
            line_r_ohm: 0.01,
            rectifier_v: 0.0,
            rectifier_r_ohm: 0.0,
            ..SupplyParts::SCHEMATIC
        };
        let (mains, dt_s) = (SimulatedMains::new(50.0), 50e-9);
        let mut bus = Bus::new(mains, parts, 0.0).unwrap();
        let (mut t_s, mut most_v) = (0.0, 0.0f64);
        // A resistive load of 10 A at the crest, until there.
        while t_s < 8e-3 {
            let i_a = if t_s < 5e-3 {
                10.0 * bus.v() / mains.peak_v
            } else {
                0.0
            };
            t_s += dt_s;
            most_v = most_v.max(bus.advance(t_s, dt_s, i_a));
        }
        let z_ohm = (0.82e-3f64 / (4.7e-6 + 0.47e-6)).sqrt();
        let expected_v = mains.peak_v + 10.0 * z_ohm;
        assert!(
            (most_v / expected_v - 1.0).abs() < 0.02,
            "{most_v} {expected_v}"
        );
        // It stays: the mains cannot take it back, bleeder and divider take 0.40 s.
        let left_v = most_v * (-(8e-3 - 5.3e-3) / (85.41e3 * 4.7e-6f64)).exp();
        assert!(
            (bus.v() / left_v - 1.0).abs() < 0.003,
            "{} {left_v}",
            bus.v()
        );
    }

    /// 94 kΩ and 4 · 232 kΩ + 6.19 kΩ side by side, on 4.7 µF: 0.4014 s.
    #[test]
    fn bleeder_and_divider_discharge_the_link() {
        let mut mains = SimulatedMains::new(50.0);
        let mut bus = Bus::new(mains, SupplyParts::SCHEMATIC, 5e-3).unwrap();
        mains = mains.changed(5e-3, 0.0, 50.0);
        bus.set_mains(mains);
        // Above what C1 has.
        bus.v = 400.0;
        for n in 1..=400_000 {
            bus.advance(5e-3 + f64::from(n) * 0.5e-6, 0.5e-6, 0.0);
        }
        let expected_v = 400.0 * (-0.2f64 / 0.4014).exp();
        assert!((bus.v() / expected_v - 1.0).abs() < 1e-3, "{}", bus.v());
    }

    /// Crest of the mains on a discharged link: ngspice 39 gives 566.2 V after 194.4 µs.
    #[test]
    fn a_discharged_link_swings_beyond_the_crest_as_in_ngspice() {
        let (mains, dt_s) = (SimulatedMains::new(50.0), 50e-9);
        let mut bus = Bus::new(mains, SupplyParts::SCHEMATIC, 5e-3).unwrap();
        bus.v = 0.0;
        let (mut t_s, mut most_v, mut at_s) = (5e-3, 0.0f64, 0.0);
        while t_s < 6e-3 {
            t_s += dt_s;
            let v = bus.advance(t_s, dt_s, 0.0);
            if v > most_v {
                (most_v, at_s) = (v, t_s - 5e-3);
            }
        }
        assert!((most_v / 566.2 - 1.0).abs() < 2e-3, "{most_v}");
        assert!((at_s / 194.4e-6 - 1.0).abs() < 0.01, "{at_s}");
    }
}
