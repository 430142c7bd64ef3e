//! Meter of the power stage: readings of whole half-cycles from one ADC sample after another.

use crate::inverter::Inverter;
use crate::meter::MeterReading;

/// Accumulator of a [`MeterReading`].
#[derive(Clone, Debug, Default)]
pub struct HalfCycleMeter {
    half_cycle: u32,
    samples: u32,
    energy_before_j: f64,
    /// Reading of the present half-cycle so far.
    pub running: MeterReading,
    /// Reading of the last complete half-cycle.
    pub last: Option<MeterReading>,
}

impl HalfCycleMeter {
    /// Adds a sample and the crests of current and coil voltage since the one before; completes the reading at the mains' zero crossing.
    pub fn sample(&mut self, inverter: &mut Inverter, (i_a, coil_v): (f64, f64)) {
        self.running.i_peak_a = self.running.i_peak_a.max(i_a);
        self.running.v_coil_peak_v = self.running.v_coil_peak_v.max(coil_v);
        let now_a = inverter.circuit.i_a;
        self.running.i_mean_a += now_a.abs();
        self.running.i_square_a2 += now_a * now_a;
        self.samples += 1;
        let t_s = inverter.now_s();
        let half_cycle = inverter.bus.mains().half_cycle(t_s);
        if half_cycle == self.half_cycle {
            return;
        }
        self.half_cycle = half_cycle;
        let energy_j = inverter.load_energy_j();
        let edges = inverter.bridge.take_commutations();
        let next = MeterReading {
            t_s,
            ..MeterReading::default()
        };
        let running = std::mem::replace(&mut self.running, next);
        let samples = f64::from(std::mem::take(&mut self.samples));
        self.last = Some(MeterReading {
            i_mean_a: running.i_mean_a / samples,
            i_square_a2: running.i_square_a2 / samples,
            duration_s: t_s - running.t_s,
            energy_j: energy_j - self.energy_before_j,
            hard_edges: edges.hard_edges,
            i_turn_off_min_a: edges.turn_off_min_a,
            ..running
        });
        self.energy_before_j = energy_j;
    }
}
