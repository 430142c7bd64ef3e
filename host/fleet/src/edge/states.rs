//! Present state of the hobs, published once a second for dashboards and MQTT. No stream stores it.

use std::sync::Arc;
use std::time::Duration;

use async_nats::Client;
use futures_util::StreamExt;
use ihd_model::DeviceReport;
use serde::{Deserialize, Serialize};

use super::link::Link;
use super::refusals::RETRY_PAUSE;
use crate::clock::now_ms;
use crate::{discovery, names};

/// Period of publication.
const PUBLISH_PERIOD: Duration = Duration::from_secs(1);

/// Age of the last half-cycle from which on its values are unknown.
const MAX_AGE: Duration = Duration::from_secs(2);

/// Present state of a hob (JSON).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StateMessage {
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// State, with the names of docs/daemon.md.
    pub state: String,
    /// Pot on the coil; `None` if unknown.
    pub pot: Option<String>,
    /// Mean power of the half-cycle in watt; `None` if unknown.
    pub power_w: Option<f64>,
    /// Requested power in watt; `None` if unknown.
    pub asked_w: Option<u16>,
    /// The device's own R at the crest of the current, in ohm.
    pub r_ohm: Option<f64>,
    /// The device's own L at the crest of the current, in henry.
    pub l_h: Option<f64>,
    /// Switching frequency in hertz, 0 with the inverter off.
    pub f_sw_hz: Option<u32>,
    /// Rise of the pot's temperature since it was put on, in kelvin.
    pub pot_rise_k: Option<f64>,
    /// Version of the lookup in use.
    pub lookup_version: u32,
}

impl StateMessage {
    /// Creates the state from the daemon's report of a device and the age of its last half-cycle; of a silent device only the state and the
    /// lookup are known.
    pub fn from_report(device: &DeviceReport, age: Option<Duration>) -> Self {
        let is_heard = device.state.is_heard() && age.is_some_and(|age| age <= MAX_AGE);
        let live = device.live.as_ref().filter(|_| is_heard);
        let finite = |x: f64| x.is_finite().then_some(x);
        Self {
            at_ms: now_ms(),
            state: device.state.as_str().to_owned(),
            pot: live.map(|l| l.pot.clone()),
            power_w: live.and_then(|l| finite(l.power_w)),
            asked_w: live.map(|l| l.asked_w),
            r_ohm: live.and_then(|l| finite(l.r_ohm)),
            l_h: live.and_then(|l| finite(l.l_h)),
            f_sw_hz: live.map(|l| l.f_sw_hz),
            pot_rise_k: device
                .pot_temperature
                .as_ref()
                .filter(|_| is_heard)
                .and_then(|t| finite(t.rise_k)),
            lookup_version: device.lookup.on_device.unwrap_or(0),
        }
    }
}

/// Publishes states until the edge stops, and discovery messages at each start of Home Assistant.
pub async fn run(link: Arc<Link>, client: Client) {
    while link
        .turn_until_stop("states", RETRY_PAUSE, publish_states(&link, &client))
        .await
    {}
}

/// Publishes as long as the edge is admitted; returns the pause before the next attempt.
async fn publish_states(link: &Link, client: &Client) -> Result<Duration, String> {
    if !link.is_admitted() {
        return Ok(RETRY_PAUSE);
    }
    let births = client.subscribe(discovery::STATUS).await;
    let mut births = births.map_err(|e| e.to_string())?;
    let mut discovered = Vec::new();
    let mut tick = tokio::time::interval(PUBLISH_PERIOD);
    link.works("states");
    while link.is_admitted() {
        tokio::select! {
            _ = tick.tick() => {}
            birth = births.next() => match birth {
                Some(birth) if &birth.payload[..] == b"online" => discovered.clear(),
                Some(_) => {}
                None => return Err("the subscription ended".to_owned()),
            },
        }
        for device in link.daemon.view().devices() {
            if !ihd_daemon::config::is_name(&device.name) {
                continue;
            }
            if !discovered.contains(&device.name) {
                for (subject, payload) in discovery::sensor_messages(&device.name) {
                    let sent = client.publish(subject, payload.into()).await;
                    sent.map_err(|e| e.to_string())?;
                }
                discovered.push(device.name.clone());
            }
            let age = link.daemon.fleet().telemetry_age(&device.name);
            let state = serde_json::to_vec(&StateMessage::from_report(&device, age));
            let state = state.map_err(|e| e.to_string())?;
            let sent = client.publish(names::state(&device.name), state.into());
            sent.await.map_err(|e| e.to_string())?;
        }
    }
    Ok(RETRY_PAUSE)
}

#[cfg(test)]
mod tests {
    use ihd_model::DeviceState;

    use super::*;

    /// Report of a hob that heats with 499.5 W.
    fn heating() -> DeviceReport {
        serde_json::from_value(serde_json::json!({
            "name": "bench", "address": "sim", "state": "learning", "since_s": 9, "detail": "", "identity": null,
            "live": {
                "half_cycle": 7, "state": "heating", "pot": "ferromagnetic", "fault": 0, "fault_text": "", "limit": "none",
                "asked_w": 500, "power_w": 499.5, "f_sw_hz": 40_000, "i_crest_a": 9.0, "r_ohm": 3.3, "l_h": 5e-5,
                "glass_hot": true
            },
            "lookup": ihd_model::LookupReport::default(), "windows": ihd_model::WindowCounts::default(),
            "asked_by_daemon_w": 500, "lease": null, "sweep_left_w": [], "sweep_is_complete": false, "recording": null, "recording_now": null,
            "connections": 1
        }))
        .unwrap()
    }

    #[test]
    fn values_of_a_hob_that_fell_silent_are_not_passed_off_as_present() {
        let of = |report: &DeviceReport, ms| {
            let state = StateMessage::from_report(report, Some(Duration::from_millis(ms)));
            (state.power_w, state.asked_w, state.f_sw_hz, state.r_ohm)
        };
        let known = (Some(499.5), Some(500), Some(40_000), Some(3.3));
        let unknown = (None, None, None, None);
        let mut report = heating();
        assert_eq!(of(&report, 2_000), known);
        assert_eq!(of(&report, 2_001), unknown);
        report.state = DeviceState::Suspended;
        assert_eq!(of(&report, 20), unknown);
    }
}
