//! Power stage: bus, half-bridge, resonance capacitor and load, in steps of a whole fraction of the switching period.

pub mod bridge;
pub mod bus;
pub mod envelope;
mod freewheel;
pub mod harmonic_analyser;
mod linear_step;
pub mod load;
pub mod node;
mod span;
pub mod supply;

use std::f64::consts::{PI, TAU};

use ihd_firmware::drive::bridge::Bridge;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use thiserror::Error;

use self::bridge::SwitchedHalfBridge;
use self::bus::Bus;
use self::load::{FluxStep, LoadState};
use super::circuit::Circuit;
use ihd_field::FieldError;

/// Integration steps between two ADC samples: 91 ns at 45 kHz. A multiple of q, so that a switching
/// period is a whole number of steps too.
pub const STEPS_PER_SAMPLE: usize = 12;

/// Integration steps of one switching period.
pub const STEPS_PER_PERIOD: usize = STEPS_PER_SAMPLE * ADC_LOCK_P / ADC_LOCK_Q as usize;

const _: () = assert!(STEPS_PER_SAMPLE.is_multiple_of(ADC_LOCK_Q as usize));

/// Error of the power stage's settings.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InverterError {
    /// A number is NaN or outside its range.
    #[error("{field} is {value}: must be {allowed}")]
    OutOfRange {
        /// Name of the setting, with its unit.
        field: &'static str,
        /// Value given.
        value: f64,
        /// Allowed range as text.
        allowed: &'static str,
    },
    /// Error of the load's field model.
    #[error(transparent)]
    Field(#[from] FieldError),
}

/// Step in seconds with which a trapezoid has the exact reactances at the switching frequency: prewarping, 2/ω · tan(ω dt/2). Those of
/// the third harmonic are 4e-4 off with [`STEPS_PER_PERIOD`].
fn prewarped_s(f_sw_hz: f64, steps: usize) -> f64 {
    libm::tan(PI / steps as f64) / (PI * f_sw_hz)
}

/// Passes a finite number inside `min..=max`.
pub(crate) fn in_range(
    field: &'static str,
    value: f64,
    min: f64,
    max: f64,
    allowed: &'static str,
) -> Result<(), InverterError> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(InverterError::OutOfRange {
            field,
            value,
            allowed,
        })
    }
}

/// Electrical quantities at the end of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Instant {
    /// Time in seconds.
    pub t_s: f64,
    /// Bus voltage in volt.
    pub bus_v: f64,
    /// Voltage of the bridge's node in volt.
    pub bridge_v: f64,
    /// Coil voltage in volt: bridge minus capacitor.
    pub coil_v: f64,
    /// Mean of the coil's voltage over the step, in volt: what R and L relate to the current, also where an edge lies inside the step.
    pub coil_mean_v: f64,
    /// Coil current in ampere.
    pub i_a: f64,
    /// Part of the coil's voltage that another field induces, in volt.
    pub induced_v: f64,
}

/// Sine induced by another coil's field: a voltage in series with the load's, inside the coil's terminals, so that both the coil's
/// voltage and its current show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InducedTone {
    /// Frequency in hertz.
    pub f_hz: f64,
    /// Amplitude in volt.
    pub v: f64,
}

/// Power stage in operation.
#[derive(Clone, Debug)]
pub struct Inverter {
    /// Supply.
    pub bus: Bus,
    /// Switches.
    pub bridge: SwitchedHalfBridge,
    /// Coil current and capacitor voltage.
    pub circuit: Circuit,
    /// Load.
    pub load: LoadState,
    /// Resistance of the conducting switch or diode, in ohm: in the loop, outside the coil.
    pub bridge_r_ohm: f64,
    /// Voltage induced by another field.
    pub induced: Option<InducedTone>,
    f_sw_hz: f64,
    dt_s: f64,
    /// Step of the loop's trapezoids: [`prewarped_s`].
    loop_dt_s: f64,
    steps: usize,
    step: usize,
    period_start_s: f64,
    /// Voltage of the node while both switches are open and no current flows, in volt.
    floating_v: Option<f64>,
    /// Coil current a step ago, in ampere.
    before_a: f64,
    /// Mean of the coil's voltage over the last step, in volt.
    coil_mean_v: f64,
    load_energy_j: f64,
    link_charge_c: f64,
}

impl Inverter {
    /// Creates a power stage at rest at `t_s`, with `steps` integration steps a period.
    pub fn new(
        bus: Bus,
        bridge: SwitchedHalfBridge,
        load: LoadState,
        f_sw_hz: f64,
        steps: usize,
        t_s: f64,
    ) -> Self {
        Self {
            bus,
            bridge,
            circuit: Circuit::default(),
            load,
            bridge_r_ohm: 0.0,
            induced: None,
            f_sw_hz,
            dt_s: 1.0 / (f_sw_hz * steps as f64),
            loop_dt_s: prewarped_s(f_sw_hz, steps),
            steps,
            step: 0,
            period_start_s: t_s,
            floating_v: None,
            before_a: 0.0,
            coil_mean_v: 0.0,
            load_energy_j: 0.0,
            link_charge_c: 0.0,
        }
    }

    /// Energy into the load since the start, its winding included, in joule: ∫ v i dt by the same
    /// trapezoids as the circuit's, so none gets lost between bridge, capacitor and load.
    pub fn load_energy_j(&self) -> f64 {
        self.load_energy_j
    }

    /// Charge that the DC link has given to the bridge since the start, in coulomb.
    pub fn link_charge_c(&self) -> f64 {
        self.link_charge_c
    }

    /// Integration step in seconds.
    pub fn dt_s(&self) -> f64 {
        self.dt_s
    }

    /// Steps of a period.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Steps done in the running period.
    pub fn step_in_period(&self) -> usize {
        self.step
    }

    /// Switching frequency in hertz.
    pub fn f_sw_hz(&self) -> f64 {
        self.f_sw_hz
    }

    /// Sets another frequency, load and number of steps; the period starts again. Current and capacitor keep their values.
    pub fn restart(&mut self, load: LoadState, f_sw_hz: f64, steps: usize) {
        self.period_start_s = self.now_s();
        self.step = 0;
        (self.load, self.f_sw_hz, self.steps) = (load, f_sw_hz, steps);
        self.dt_s = 1.0 / (f_sw_hz * steps as f64);
        self.loop_dt_s = prewarped_s(f_sw_hz, steps);
    }

    /// Time now, in seconds.
    pub fn now_s(&self) -> f64 {
        self.period_start_s + self.step as f64 * self.dt_s()
    }

    /// Present quantities.
    pub fn instant(&self) -> Instant {
        let driven_v = self.bus.v() * self.bridge.level() - self.bridge_r_ohm * self.circuit.i_a;
        let bridge_v = self.floating_v.unwrap_or(driven_v);
        Instant {
            t_s: self.now_s(),
            bus_v: self.bus.v(),
            bridge_v,
            coil_v: bridge_v - self.circuit.v_c_v,
            coil_mean_v: self.coil_mean_v,
            i_a: self.circuit.i_a,
            induced_v: self.induced_v(self.now_s()),
        }
    }

    /// Voltage induced by another field at `t_s`, in volt.
    fn induced_v(&self, t_s: f64) -> f64 {
        self.induced
            .map_or(0.0, |tone| tone.v * libm::sin(TAU * tone.f_hz * t_s))
    }

    /// Advances the loop by one step under a mean voltage `node_v` of the driven node behind its switches.
    fn step_loop(&mut self, node_v: f64, flux: &FluxStep) {
        let induced_v = self.induced_v(self.now_s() + 0.5 * self.dt_s);
        let r_ohm = flux.r_ohm + self.bridge_r_ohm;
        self.circuit.step_flux(
            node_v - induced_v,
            r_ohm,
            flux.change0_wb,
            flux.l_h,
            self.loop_dt_s,
        );
    }

    /// Advances by one step.
    pub fn advance(&mut self, bridge: Bridge) -> Instant {
        match bridge {
            Bridge::Open => self.freewheel(),
            Bridge::LowerOn => self.drive(false),
            Bridge::Switching => self.drive(true),
        }
        self.instant()
    }

    /// Advances by one step with the bridge switching, or with its lower switch on.
    fn drive(&mut self, on: bool) {
        self.floating_v = None;
        let dt_s = self.dt_s();
        let (from_s, i_a) = (self.step as f64 * dt_s, self.circuit.i_a);
        let flux = self.load.predict(i_a);
        let (before, bus_before_v) = (self.circuit, self.bus.v());
        let level = self.bridge.advance(
            on,
            self.steps as f64 * dt_s,
            (from_s, from_s + dt_s),
            i_a,
            bus_before_v,
        );
        let drawn_a = level * self.mean_a();
        self.link_charge_c += drawn_a * dt_s;
        let bus_v = self
            .bus
            .advance(self.period_start_s + from_s + dt_s, dt_s, drawn_a);
        // The bus moves by some 1e-5 of its peak within a step.
        let mean_v = 0.5 * (bus_before_v + bus_v) * level;
        self.step_loop(mean_v, &flux);
        self.meter(mean_v, before, dt_s);
        self.finish(&flux, i_a);
    }

    /// Mean of the coil's current over the coming step, in ampere: it goes on as in the step before.
    fn mean_a(&self) -> f64 {
        1.5 * self.circuit.i_a - 0.5 * self.before_a
    }

    /// Takes the coil's mean voltage and the energy of a step with a mean voltage of the node behind its switches, from `before` until
    /// now.
    fn meter(&mut self, node_v: f64, before: Circuit, dt_s: f64) {
        let now = self.circuit;
        let mean_a = 0.5 * (before.i_a + now.i_a);
        self.coil_mean_v = node_v - self.bridge_r_ohm * mean_a - 0.5 * (before.v_c_v + now.v_c_v);
        self.load_energy_j += self.coil_mean_v * mean_a * dt_s;
    }

    /// Passes the new current to the load, and counts the step.
    fn finish(&mut self, flux: &FluxStep, before_a: f64) {
        self.before_a = before_a;
        self.step += 1;
        self.end_period();
        self.load.commit(flux, self.step, self.circuit.i_a);
    }

    /// Begins the next period after the last step of one.
    fn end_period(&mut self) {
        if self.step == self.steps {
            self.period_start_s += self.steps as f64 * self.dt_s;
            self.step = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::harmonic_analyser::HarmonicAnalyser;
    use super::load::AmplitudeLaw;
    use super::supply::SupplyParts;
    use super::*;
    use crate::behavioural::{BehaviouralLoad, PotKind};
    use crate::mains::SimulatedMains;
    use ihd_field::model::FieldSettings;
    use ihd_field::{FieldModel, harmonic};

    /// Truth of the last of `periods` periods, and the amplitude's law there.
    fn run(
        load: LoadState,
        f: f64,
        steps: usize,
        periods: usize,
        mains_hz: f64,
    ) -> ihd_signal::truth::PeriodTruth {
        let bus = Bus::new(SimulatedMains::new(mains_hz), SupplyParts::NONE, 0.0).unwrap();
        let bridge = SwitchedHalfBridge::new(0.0, 0.2e-6).unwrap();
        let mut inverter = Inverter::new(bus, bridge, load, f, steps, 0.0);
        let mut analyser = HarmonicAnalyser::new(steps);
        let mut truth = None;
        for _ in 0..periods {
            let start = inverter.instant();
            analyser.push(0, start.coil_v, start.i_a);
            let mut last = start;
            for n in 1..=steps {
                last = inverter.advance(Bridge::Switching);
                analyser.push(n, last.coil_v, last.i_a);
            }
            truth = Some(analyser.truth(last.t_s, f, last.i_a));
        }
        truth.unwrap()
    }

    #[test]
    fn the_meter_reads_the_behavioural_law() {
        let law = BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
        let truth = run(
            LoadState::law(AmplitudeLaw::Behavioural(law), 1111),
            45e3,
            1111,
            150,
            50.0,
        );
        let (r, l) = law.r_l(truth.i_a);
        assert!((truth.r_ohm[0] / r - 1.0).abs() < 3e-3, "{truth:?} {r}");
        assert!((truth.l_h[0] / l - 1.0).abs() < 3e-3, "{truth:?} {l}");
        // The equation holds for every harmonic.
        assert!((truth.l_h[1] / l - 1.0).abs() < 1e-2);
    }

    #[test]
    fn field_in_the_circuit_has_the_describing_functions_fundamental() {
        let model = FieldModel::new(&FieldSettings::paper()).unwrap();
        let dt = 1.0 / (45e3 * 1111.0);
        let load = LoadState::field(&[(1.0, model.clone())], dt).unwrap();
        let truth = run(load, 45e3, 1111, 150, 50.0);
        let z = harmonic::impedance(&model, 45e3, truth.i_a).unwrap();
        println!("{truth:?} {z:?}");
        assert!((truth.l_h[0] / z.l_h - 1.0).abs() < 0.03);
        assert!((truth.r_ohm[0] / z.r_ohm - 1.0).abs() < 0.06);
        // Harmonics see less: the equation of the paper does not hold within a period.
        assert!(truth.l_h[1] < 0.75 * truth.l_h[0]);
    }
}
