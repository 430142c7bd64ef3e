//! Pot on a device's coil: temperature rise ΔT from telemetry, and pot events.
//!
//! The state lasts as long as the daemon: after a restart ΔT begins at 0. The alloys of pots that boiled water are stored.

use std::collections::VecDeque;

use ihd_model::{PotCurve, PotPoint, PotTemperature};
use ihd_shared::wire::messages::{Pot, Telemetry};
use ihd_thermal::{GAP_S, KnownAlloys, PotEvent, ThermalHalfCycle, Thermometer};

/// Interval between two points of the curve, in milliseconds.
const POINT_MS: i64 = 2_000;

/// Length of the curve in points: one hour.
const MAX_POINTS: usize = 1_800;

/// Half-cycle of 50 Hz in seconds, until a window brings the measured one.
const HALF_CYCLE_S: f64 = 0.01;

/// Half-cycles of mains from 45 to 66 Hz, in seconds; other values are ignored.
const HALF_CYCLES_S: std::ops::RangeInclusive<f64> = 7.5e-3..=11.2e-3;

/// Temperature tracker of the pot on one coil.
#[derive(Debug)]
pub struct PotTracker {
    thermometer: Thermometer,
    /// Alloys as they are stored.
    stored_alloys: KnownAlloys,
    half_cycle_s: f64,
    boot: Option<u32>,
    /// Last half-cycle and its time in seconds.
    last: Option<(u32, f64)>,
    since_ms: i64,
    points: VecDeque<PotPoint>,
}

impl Default for PotTracker {
    fn default() -> Self {
        Self {
            thermometer: Thermometer::default(),
            stored_alloys: KnownAlloys::default(),
            half_cycle_s: HALF_CYCLE_S,
            boot: None,
            last: None,
            since_ms: 0,
            points: VecDeque::new(),
        }
    }
}

impl PotTracker {
    /// Sets the alloys that the store has, as JSON.
    ///
    /// # Errors
    /// If the text is something else; the alloys stay as they are.
    pub fn set_stored_alloys(&mut self, json: &[u8]) -> serde_json::Result<()> {
        self.stored_alloys = serde_json::from_slice(json)?;
        self.thermometer.set_alloys(self.stored_alloys.clone());
        Ok(())
    }

    /// Returns the alloys as JSON if they have changed since they were stored, and takes them for stored.
    pub fn take_unstored_alloys(&mut self) -> Option<Vec<u8>> {
        let alloys = self.thermometer.alloys();
        if *alloys == self.stored_alloys {
            return None;
        }
        let json = serde_json::to_vec(alloys).ok()?;
        self.stored_alloys = alloys.clone();
        Some(json)
    }

    /// Records that the store does not have the alloys after all.
    pub fn alloys_were_not_stored(&mut self) {
        self.stored_alloys = KnownAlloys::default();
    }

    /// Sets the measured duration of a half-cycle in seconds; ignored if out of range.
    pub fn set_half_cycle(&mut self, half_cycle_s: f64) {
        if HALF_CYCLES_S.contains(&half_cycle_s) {
            self.half_cycle_s = half_cycle_s;
        }
    }

    /// Starts a connection to a boot of the device; a new boot resets the tracker, as its half-cycles count anew.
    pub fn begin_boot(&mut self, boot: u32) {
        if self.boot.replace(boot) != Some(boot) {
            self.reset();
        }
    }

    /// Resets the tracker: another pot, or a restarted device.
    pub fn reset(&mut self) {
        self.thermometer.begin_anew();
        self.last = None;
        self.points.clear();
    }

    /// Processes a half-cycle received at `now_ms` and returns the events. Takes microseconds; once per pot, after a batch, some
    /// tens of milliseconds.
    pub fn push(&mut self, t: &Telemetry, now_ms: i64) -> Vec<PotEvent> {
        if matches!(t.pot, Pot::Absent | Pot::Unsuitable) {
            if self.last.is_some() {
                self.reset();
            }
            return Vec::new();
        }
        let t_s = match self.last {
            None => 0.0,
            Some((before, t_s)) => {
                let passed = t.half_cycle.wrapping_sub(before);
                // A duplicate, or out of order.
                if passed == 0 || passed > u32::MAX / 2 {
                    return Vec::new();
                }
                let passed_s = f64::from(passed) * self.half_cycle_s;
                if passed_s > GAP_S {
                    self.reset();
                    0.0
                } else {
                    t_s + passed_s
                }
            }
        };
        self.last = Some((t.half_cycle, t_s));
        self.thermometer
            .push(&ThermalHalfCycle::from_telemetry(t, t_s));
        let events = self.thermometer.take_events();
        if events.iter().any(|e| matches!(e, PotEvent::Placed { .. })) {
            self.since_ms = now_ms;
            self.points.clear();
        }
        self.add_point(now_ms);
        events
    }

    fn add_point(&mut self, now_ms: i64) {
        let due = |p: &PotPoint| now_ms - p.at_ms >= POINT_MS || now_ms < p.at_ms;
        let Some(reading) = self
            .thermometer
            .reading()
            .filter(|_| self.points.back().is_none_or(due))
        else {
            return;
        };
        if self.points.len() == MAX_POINTS {
            self.points.pop_front();
        }
        self.points.push_back(PotPoint {
            at_ms: now_ms,
            rise_k: reading.rise_k,
            sigma_k: reading.sigma_k,
        });
    }

    /// Returns the present estimate; `None` if there is no pot or no finite estimate.
    pub fn now(&self) -> Option<PotTemperature> {
        let r = self.thermometer.reading()?;
        let finite = [r.rise_k, r.sigma_k, r.lift_mm, r.lift_sigma_mm];
        finite
            .iter()
            .all(|x| x.is_finite())
            .then_some(PotTemperature {
                since_ms: self.since_ms,
                rise_k: r.rise_k,
                sigma_k: r.sigma_k,
                prior_k: r.prior_k.0,
                prior_sigma_k: r.prior_k.1,
                lift_mm: r.lift_mm,
                lift_sigma_mm: r.lift_sigma_mm,
                bubbles: r.bubbles,
                boils: r.boils,
                overheats: r.overheats,
            })
    }

    /// Returns the curve of this pot, with the present estimate.
    pub fn curve(&self) -> PotCurve {
        PotCurve {
            now: self.now(),
            points: self.points.iter().copied().collect(),
        }
    }
}

/// Describes an event for logs and reports.
pub fn describe(event: &PotEvent) -> String {
    match *event {
        PotEvent::Placed {
            diameter_m,
            is_cast_iron,
            is_sure,
        } => format!(
            "its temperature is followed from here: {} of about {:.0} cm by R and L",
            match (is_sure, is_cast_iron) {
                (true, true) => "cast iron",
                (true, false) => "ferritic steel",
                (false, _) => "iron or steel",
            },
            100.0 * diameter_m
        ),
        PotEvent::Moved { lift_mm, straight } => format!(
            "moved: lift {lift_mm:+.1} mm{}",
            if straight { "" } else { ", and shifted" }
        ),
        PotEvent::Bubbles => "bubbles carry the heat from its base".to_owned(),
        PotEvent::Boils { .. } => "its contents boil".to_owned(),
        PotEvent::Overheats {
            rise_k,
            toward_curie,
        } => format!(
            "overheats: {rise_k:.0} K warmer than when it was put on{}",
            if toward_curie {
                ", beyond the turn toward the Curie point"
            } else {
                ""
            }
        ),
    }
}

#[cfg(test)]
mod tests {
    use ihd_link::{Client, DeviceEvent};
    use ihd_sim::hob::{HobConfig, SimHob};
    use ihd_sim::recording::settings::LoadKind;
    use ihd_sim::transport::SharedHob;
    use ihd_thermal::MetalLaw;
    use std::time::Duration;

    use super::*;

    fn telemetry(half_cycles: u32) -> Vec<Telemetry> {
        let hob = SharedHob::new(SimHob::new(&HobConfig {
            load: LoadKind::Surrogate,
            warming: true,
            ..HobConfig::default()
        }));
        let mut client = Client::connect(Box::new(hob)).unwrap();
        client.stream(1, 0).unwrap();
        client.set_power(1500).unwrap();
        let mut all = Vec::new();
        while all.len() < half_cycles as usize {
            if let Some(DeviceEvent::Telemetry(t)) =
                client.next_event(Duration::from_secs(5)).unwrap()
            {
                all.push(t);
            }
        }
        all
    }

    #[test]
    fn a_pot_is_followed_and_another_one_begins_at_zero() {
        let all = telemetry(250);
        let mut tracker = PotTracker::default();
        let mut events = Vec::new();
        for (k, t) in all.iter().enumerate() {
            // Twice: as after a reconnection.
            events.extend(tracker.push(t, 10 * k as i64));
            events.extend(tracker.push(t, 10 * k as i64));
        }
        assert!(
            matches!(events[..], [PotEvent::Placed { .. }]),
            "{events:?}"
        );
        let now = tracker.now().unwrap();
        // 1.5 kW on the lump of 900 J/K for 2 s.
        assert!((1.0..7.0).contains(&now.rise_k), "{now:?}");
        let curve = tracker.curve();
        assert!((1..=3).contains(&curve.points.len()), "{curve:?}");
        let mut gone = all[249].clone();
        gone.pot = Pot::Absent;
        gone.half_cycle += 1;
        tracker.push(&gone, 6_000);
        assert_eq!(
            (tracker.now(), tracker.curve()),
            (None, PotCurve::default())
        );
        // The same boot goes on after a cut link, another one begins anew.
        tracker.begin_boot(7);
        all.iter().for_each(|t| drop(tracker.push(t, 10)));
        tracker.begin_boot(7);
        assert!(tracker.now().is_some());
        tracker.begin_boot(8);
        assert_eq!(tracker.now(), None);
        all.iter().for_each(|t| drop(tracker.push(t, 10)));
        assert!(tracker.now().is_some());
    }

    #[test]
    fn alloys_are_stored_once_and_what_no_boil_taught_is_refused() {
        let alloy = serde_json::json!({
            "metal": MetalLaw::FERRITIC, "numbers": [7.3, -11.2, 0.09], "effects": [1.1, 1.12],
        });
        let stored = serde_json::json!([alloy]).to_string();
        let mut tracker = PotTracker::default();
        assert_eq!(tracker.take_unstored_alloys(), None);
        tracker.set_stored_alloys(stored.as_bytes()).unwrap();
        assert_eq!(tracker.take_unstored_alloys(), None);
        // As after a boil.
        let mut taught = PotTracker::default();
        let alloys = tracker.thermometer.alloys().clone();
        taught.thermometer.set_alloys(alloys);
        let json = taught.take_unstored_alloys().unwrap();
        assert_eq!(taught.take_unstored_alloys(), None);
        taught.alloys_were_not_stored();
        assert_eq!(taught.take_unstored_alloys().unwrap(), json);
        let mut restored = PotTracker::default();
        restored.set_stored_alloys(&json).unwrap();
        assert_eq!(restored.thermometer.alloys(), tracker.thermometer.alloys());
        for wrong in [
            "",
            "{}",
            r#"[{"metal":null}]"#,
            &serde_json::json!(vec![&alloy; 17]).to_string(),
            &stored.replace("[1.1,1.12]", "[]"),
            &stored.replace("[1.1,1.12]", "[1,1,1,1,1,1]"),
        ] {
            assert!(
                restored.set_stored_alloys(wrong.as_bytes()).is_err(),
                "{wrong}"
            );
        }
        assert_eq!(restored.thermometer.alloys(), tracker.thermometer.alloys());
    }

    #[test]
    fn what_a_device_makes_up_is_survived() {
        let good = telemetry(60).pop().unwrap();
        let mut tracker = PotTracker::default();
        for k in 0..20_000u32 {
            let mut t = good.clone();
            t.half_cycle = k.wrapping_mul(2_654_435_761);
            t.f_sw_hz = k.wrapping_mul(40_503);
            t.r.0 = k.wrapping_mul(747_796_405) as i32;
            t.l.0 = k.wrapping_mul(2_891_336_453) as i32;
            t.power_mw = k.wrapping_mul(1_103_515_245);
            tracker.push(&t, i64::from(k));
        }
        assert!(tracker.curve().points.len() <= MAX_POINTS);
        tracker.set_half_cycle(f64::NAN);
        tracker.set_half_cycle(1.0);
        assert_eq!(tracker.half_cycle_s, HALF_CYCLE_S);
    }
}
