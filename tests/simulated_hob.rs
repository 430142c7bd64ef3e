//! The simulated hob with its client: the firmware's own code, closed over the plant.
//!
//! Simulated time passes only while somebody waits for bytes, so nothing here depends on how fast
//! the machine is.

use std::f64::consts::TAU;
use std::time::Duration;

use ihd_link::{Client, DeviceEvent};
use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::wire::messages::Telemetry;
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

/// Simulated time without an event that means the hob has fallen silent.
const PATIENCE: Duration = Duration::from_secs(2);

/// A hob, whoever talks to it, and everything it has sent so far.
pub struct Kitchen {
    /// The host's end.
    pub client: Client,
    /// The hob itself.
    pub hob: SharedHob,
    /// Events in their order.
    pub events: Vec<DeviceEvent>,
}

impl Kitchen {
    /// A hob that streams a telemetry every half-cycle.
    ///
    /// # Panics
    /// When the hob refuses: the test then fails where it should. So do the other functions here.
    pub fn new(config: HobConfig) -> Self {
        let hob = SharedHob::new(SimHob::new(&config));
        let mut client = Client::connect(Box::new(hob.clone())).unwrap();
        client.stream(1, 0).unwrap();
        Self {
            client,
            hob,
            events: Vec::new(),
        }
    }

    /// The default hob with another pot.
    pub fn with_pot(pot: PotKind) -> Self {
        Self::new(HobConfig {
            pot: pot.into(),
            ..HobConfig::default()
        })
    }

    /// A hob that has heated for 80 half-cycles.
    pub fn heating(power_w: u16) -> Self {
        let mut kitchen = Self::new(HobConfig::default());
        kitchen.client.set_power(power_w).unwrap();
        kitchen.watch(80);
        kitchen
    }

    /// Takes events until that many more telemetries have come; returns the telemetries.
    pub fn watch(&mut self, half_cycles: usize) -> Vec<Telemetry> {
        let mut seen = Vec::new();
        while seen.len() < half_cycles {
            let event = self.client.next_event(PATIENCE).unwrap();
            let event = event.expect("the hob must not fall silent");
            if let DeviceEvent::Telemetry(t) = &event {
                seen.push(t.clone());
            }
            self.events.push(event);
        }
        seen
    }

    /// Highest resonant frequency of the true load in a half-cycle, in hertz.
    pub fn resonance_hz(&self, half_cycle: u32) -> f64 {
        let truth = self
            .hob
            .truth(half_cycle)
            .expect("the truth of what was reported");
        let l_h = truth.l_h.iter().copied().fold(f64::INFINITY, f64::min);
        (TAU * (l_h * f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9).sqrt()).recip()
    }
}
