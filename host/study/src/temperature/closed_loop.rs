//! One complete boil with the firmware itself, its control, filter and link, as a check of the simulation by tables.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use ihd_link::{Client, DeviceEvent};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::transport::SharedHob;
use ihd_thermal::{PotEvent, ThermalHalfCycle, Thermometer};
use serde::Serialize;

/// Time evaluated after the boil, in seconds.
const AFTER_S: f64 = 40.0;

/// Limit of a run in seconds.
const MAX_DURATION_S: f64 = 600.0;

/// Result of the run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ClosedLoopResult {
    /// Length in seconds of the hob.
    pub duration_s: f64,
    /// ΔT in K rms.
    pub rms_k: f64,
    /// Largest true rise in K.
    pub largest_k: f64,
    /// Time at which all of the water boiled, in seconds.
    pub boils_s: Option<f64>,
    /// Time at which the boil was reported, in seconds.
    #[serde(rename = "boils_said_s")]
    pub boils_reported_s: Option<f64>,
    /// Time at which bubbles carried half of the heat, in seconds.
    pub bubbles_s: Option<f64>,
    /// Time at which bubbles were reported, in seconds.
    #[serde(rename = "bubbles_said_s")]
    pub bubbles_reported_s: Option<f64>,
    /// Number of reported moves; there was none.
    pub moves: u32,
}

/// Runs 0.3 litre in a ferritic pot of 15 cm at 1000 W, from tables of the field; some minutes. `progress` is called with the hob's
/// seconds.
///
/// # Errors
/// If the hob does not answer.
pub fn run(progress: &dyn Fn(f64)) -> Result<ClosedLoopResult> {
    let hob = SharedHob::new(SimHob::new(&HobConfig {
        load: LoadKind::Surrogate,
        pot: "ferritic-15".parse()?,
        warming: true,
        contents: "water-0.3".parse()?,
        ..HobConfig::default()
    }));
    let mut client = Client::connect(Box::new(hob.clone()))?;
    client.stream(1, 0)?;
    client.set_power(1000)?;
    let mut thermometer = Thermometer::default();
    let mut out = ClosedLoopResult::default();
    let (mut squares, mut readings) = (0.0, 0u32);
    loop {
        let event = client.next_event(Duration::from_secs(5))?;
        let DeviceEvent::Telemetry(t) = event.context("the hob is silent")? else {
            continue;
        };
        // The device switches off ten seconds after the host's last message.
        if t.half_cycle.is_multiple_of(300) {
            client.status()?;
        }
        thermometer.push(&ThermalHalfCycle::from_telemetry(
            &t,
            f64::from(t.half_cycle) * 0.01,
        ));
        let (t_s, truth) = {
            let sim = hob.lock();
            (sim.t_s(), sim.thermal().copied())
        };
        let Some(truth) = truth else {
            bail!("the simulated pot does not warm up");
        };
        if truth.bubble_share() > 0.5 {
            out.bubbles_s.get_or_insert(t_s);
        }
        if truth.is_boiling() {
            out.boils_s.get_or_insert(t_s);
        }
        for event in thermometer.take_events() {
            out.record_event(t_s, event);
        }
        if let Some(estimate) = thermometer.reading() {
            let rise_k = truth.temperature_c() - 20.0;
            squares += (estimate.rise_k - rise_k) * (estimate.rise_k - rise_k);
            readings += 1;
            out.largest_k = out.largest_k.max(rise_k);
        }
        out.duration_s = t_s;
        progress(t_s);
        if t_s > MAX_DURATION_S || out.boils_s.is_some_and(|boils_s| t_s > boils_s + AFTER_S) {
            break;
        }
    }
    out.rms_k = (squares / f64::from(readings.max(1))).sqrt();
    Ok(out)
}

impl ClosedLoopResult {
    fn record_event(&mut self, t_s: f64, event: PotEvent) {
        match event {
            PotEvent::Bubbles => {
                self.bubbles_reported_s.get_or_insert(t_s);
            }
            PotEvent::Boils { .. } => {
                self.boils_reported_s.get_or_insert(t_s);
            }
            PotEvent::Moved { .. } => self.moves += 1,
            PotEvent::Placed { .. } | PotEvent::Overheats { .. } => {}
        }
    }

    /// Text for the document.
    pub fn text(&self) -> String {
        let of = |x: Option<f64>| x.map_or("never".to_owned(), |x| format!("{x:.0} s"));
        format!(
            "With the firmware itself (0.3 l, ferritic-15, 1000 W, {:.0} s): ΔT {:.1} K rms up to {:.0} K; plateau at {}, said at {}; boil at {}, \
             said at {}; moves told: {}.\n",
            self.duration_s,
            self.rms_k,
            self.largest_k,
            of(self.bubbles_s),
            of(self.bubbles_reported_s),
            of(self.boils_s),
            of(self.boils_reported_s),
            self.moves,
        )
    }
}
