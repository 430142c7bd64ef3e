//! The pot on a device's coil: ΔT from its telemetry, and what happens to it.
//!
//! What is known lives as long as the daemon: after a restart ΔT begins at 0 again.

use std::collections::VecDeque;

use ihd_shared::wire::messages::{Pot, Telemetry};
use ihd_thermal::{HalfCycle, PotEvent, Thermometer};

use crate::model::{PotCurve, PotPoint, PotTemperature};

/// Between two points of the curve, in milliseconds.
const POINT_MS: i64 = 2_000;

/// Points that are kept: an hour.
const POINTS: usize = 1_800;

/// A half-cycle of 50 Hz in seconds, until a window has told the mains' own.
const HALF_CYCLE_S: f64 = 0.01;

/// Half-cycles of a mains from 45 to 66 Hz, in seconds; what else is told is not believed.
const HALF_CYCLES_S: std::ops::RangeInclusive<f64> = 7.5e-3..=11.2e-3;

/// A count that jumps on by more half-cycles than these, ten minutes, is another run's.
const FAR: u32 = 60_000;

/// Follows one pot after the other.
#[derive(Debug)]
pub struct PotWatch {
    thermometer: Thermometer,
    half_cycle_s: f64,
    boot: Option<u32>,
    /// The last half-cycle, and its time in seconds.
    last: Option<(u32, f64)>,
    since_ms: i64,
    points: VecDeque<PotPoint>,
}

impl Default for PotWatch {
    fn default() -> Self {
        Self {
            thermometer: Thermometer::default(),
            half_cycle_s: HALF_CYCLE_S,
            boot: None,
            last: None,
            since_ms: 0,
            points: VecDeque::new(),
        }
    }
}

impl PotWatch {
    /// The device says how long a half-cycle of its mains is, in seconds.
    pub fn half_cycle_lasts(&mut self, half_cycle_s: f64) {
        if HALF_CYCLES_S.contains(&half_cycle_s) {
            self.half_cycle_s = half_cycle_s;
        }
    }

    /// A device is there, in this boot: half-cycles of another one count from elsewhere.
    pub fn of_boot(&mut self, boot: u32) {
        if self.boot.replace(boot) != Some(boot) {
            self.begin_anew();
        }
    }

    /// Nothing is known any more: another pot, or a device that began anew.
    pub fn begin_anew(&mut self) {
        self.thermometer.begin_anew();
        self.last = None;
        self.points.clear();
    }

    /// A half-cycle, heard at `now_ms`. Takes microseconds, and once a pot, after a batch, some tens of milliseconds.
    pub fn push(&mut self, t: &Telemetry, now_ms: i64) -> Vec<PotEvent> {
        if matches!(t.pot, Pot::Absent | Pot::Unsuitable) {
            if self.last.is_some() {
                self.begin_anew();
            }
            return Vec::new();
        }
        let t_s = match self.last {
            None => 0.0,
            Some((before, t_s)) => {
                let passed = t.half_cycle.wrapping_sub(before);
                // The same twice, or one that comes late.
                if passed == 0 || passed > u32::MAX / 2 {
                    return Vec::new();
                }
                if passed > FAR {
                    self.begin_anew();
                    0.0
                } else {
                    t_s + f64::from(passed) * self.half_cycle_s
                }
            }
        };
        self.last = Some((t.half_cycle, t_s));
        self.thermometer.push(&HalfCycle::from_telemetry(t, t_s));
        let events = self.thermometer.take_events();
        if events.iter().any(|e| matches!(e, PotEvent::Placed { .. })) {
            self.since_ms = now_ms;
            self.points.clear();
        }
        self.keep_point(now_ms);
        events
    }

    fn keep_point(&mut self, now_ms: i64) {
        let due = |p: &PotPoint| now_ms - p.at_ms >= POINT_MS || now_ms < p.at_ms;
        let Some(reading) = self
            .thermometer
            .reading()
            .filter(|_| self.points.back().is_none_or(due))
        else {
            return;
        };
        if self.points.len() == POINTS {
            self.points.pop_front();
        }
        self.points.push_back(PotPoint {
            at_ms: now_ms,
            rise_k: reading.rise_k,
            sigma_k: reading.sigma_k,
        });
    }

    /// What is known now.
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
                lift_mm: r.lift_mm,
                lift_sigma_mm: r.lift_sigma_mm,
                bubbles: r.bubbles,
                boils: r.boils,
                overheats: r.overheats,
            })
    }

    /// The curve so far.
    pub fn curve(&self) -> PotCurve {
        PotCurve {
            now: self.now(),
            points: self.points.iter().copied().collect(),
        }
    }
}

/// What happened, in words.
pub fn words(event: &PotEvent) -> String {
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
    use ihd_link::{Client, Event};
    use ihd_sim::hob::{HobConfig, SimHob};
    use ihd_sim::recording::settings::LoadKind;
    use ihd_sim::transport::SharedHob;
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
            if let Some(Event::Telemetry(t)) = client.next_event(Duration::from_secs(5)).unwrap() {
                all.push(t);
            }
        }
        all
    }

    #[test]
    fn a_pot_is_followed_and_another_one_begins_at_zero() {
        let all = telemetry(500);
        let mut watch = PotWatch::default();
        let mut events = Vec::new();
        for (k, t) in all.iter().enumerate() {
            // Twice: as after a reconnection.
            events.extend(watch.push(t, 10 * k as i64));
            events.extend(watch.push(t, 10 * k as i64));
        }
        assert!(
            matches!(events[..], [PotEvent::Placed { .. }]),
            "{events:?}"
        );
        let now = watch.now().unwrap();
        // 1.5 kW on the lump of 900 J/K for 4.5 s.
        assert!((3.0..12.0).contains(&now.rise_k), "{now:?}");
        let curve = watch.curve();
        assert!((1..=3).contains(&curve.points.len()), "{curve:?}");
        let mut gone = all[499].clone();
        gone.pot = Pot::Absent;
        gone.half_cycle += 1;
        watch.push(&gone, 6_000);
        assert_eq!((watch.now(), watch.curve()), (None, PotCurve::default()));
        // The same boot goes on after a cut link, another one begins anew.
        watch.of_boot(7);
        all.iter().for_each(|t| drop(watch.push(t, 10)));
        watch.of_boot(7);
        assert!(watch.now().is_some());
        watch.of_boot(8);
        assert_eq!(watch.now(), None);
        all.iter().for_each(|t| drop(watch.push(t, 10)));
        assert!(watch.now().is_some());
    }

    #[test]
    fn what_a_device_makes_up_is_survived() {
        let good = telemetry(60).pop().unwrap();
        let mut watch = PotWatch::default();
        for k in 0..20_000u32 {
            let mut t = good.clone();
            t.half_cycle = k.wrapping_mul(2_654_435_761);
            t.f_sw_hz = k.wrapping_mul(40_503);
            t.r.0 = k.wrapping_mul(747_796_405) as i32;
            t.l.0 = k.wrapping_mul(2_891_336_453) as i32;
            t.power_mw = k.wrapping_mul(1_103_515_245);
            watch.push(&t, i64::from(k));
        }
        assert!(watch.curve().points.len() <= POINTS);
        watch.half_cycle_lasts(f64::NAN);
        watch.half_cycle_lasts(1.0);
        assert_eq!(watch.half_cycle_s, HALF_CYCLE_S);
    }
}
