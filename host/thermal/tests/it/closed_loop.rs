//! The simulated hob with the firmware itself, through the link.

use std::time::Duration;

use ihd_link::{Client, DeviceEvent};
use ihd_shared::wire::messages::Telemetry;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::transport::SharedHob;
use ihd_thermal::{ThermalHalfCycle, Thermometer};

fn half_cycle(t: &Telemetry) -> ThermalHalfCycle {
    ThermalHalfCycle::from_telemetry(t, f64::from(t.half_cycle) * 0.01)
}

/// The firmware's own control, filter and link; the load is the field's table.
#[test]
fn the_firmwares_telemetry_shows_how_warm_the_pot_is_at_length() {
    let hob = SharedHob::new(SimHob::new(&HobConfig {
        load: LoadKind::Surrogate,
        pot: "ferritic-15".parse().unwrap(),
        warming: true,
        contents: "water-0.3".parse().unwrap(),
        ..HobConfig::default()
    }));
    let mut client = Client::connect(Box::new(hob.clone())).unwrap();
    client.stream(1, 0).unwrap();
    client.set_power(1000).unwrap();
    let mut thermometer = Thermometer::default();
    let (mut squares, mut looks, mut largest_k) = (0.0, 0, 0.0f64);
    loop {
        let event = client.next_event(Duration::from_secs(5)).unwrap();
        let Some(DeviceEvent::Telemetry(t)) = event else {
            continue;
        };
        if t.half_cycle.is_multiple_of(300) {
            client.status().unwrap();
        }
        if t.half_cycle == 1500 {
            client.set_power(800).unwrap();
        }
        thermometer.push(&half_cycle(&t));
        if let Some(reading) = thermometer.reading() {
            let truth_c = hob.lock().thermal().unwrap().temperature_c();
            let off_k = reading.rise_k - (truth_c - 20.0);
            squares += off_k * off_k;
            looks += 1;
            largest_k = largest_k.max(truth_c - 20.0);
        }
        if t.half_cycle >= 3000 {
            break;
        }
    }
    let rms_k = (squares / f64::from(looks)).sqrt();
    println!(
        "{rms_k} K rms up to {largest_k} K, {:?} {:?}",
        thermometer.reading(),
        thermometer.take_events()
    );
    assert!(looks > 2500 && largest_k > 35.0, "{looks} {largest_k}");
    assert!(rms_k < 5.0, "{rms_k} K");
}

/// Noise and bias of the firmware that the tables' cooking assumes (host/sim/src/cooking.rs).
#[test]
fn noise_and_bias_of_the_firmwares_r_and_l() {
    for (pot, power_w) in [("ferritic-21", 1500), ("cast-iron-18", 1500)] {
        let hob = SharedHob::new(SimHob::new(&HobConfig {
            load: LoadKind::Surrogate,
            pot: pot.parse().unwrap(),
            ..HobConfig::default()
        }));
        let mut client = Client::connect(Box::new(hob.clone())).unwrap();
        client.stream(1, 0).unwrap();
        client.set_power(power_w).unwrap();
        let (mut r_pct, mut l_pct) = (Vec::new(), Vec::new());
        while r_pct.len() < 100 {
            let event = client.next_event(Duration::from_secs(5)).unwrap();
            let Some(DeviceEvent::Telemetry(t)) = event.filter(|_| hob.lock().t_s() > 1.0) else {
                continue;
            };
            let (h, sim) = (half_cycle(&t), hob.lock());
            let Some(truth) = sim.truth(t.half_cycle) else {
                continue;
            };
            let at = |k: &usize| truth.i_a[*k];
            let crest = (0..truth.i_a.len()).max_by(|a, b| at(a).total_cmp(&at(b)));
            let crest = crest.unwrap();
            r_pct.push(100.0 * (h.r_ohm / truth.r_ohm[crest] - 1.0));
            l_pct.push(100.0 * (h.l_h / truth.l_h[crest] - 1.0));
        }
        let of = |x: &[f64]| {
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            let square = x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>();
            (mean, (square / x.len() as f64).sqrt())
        };
        let (r, l) = (of(&r_pct), of(&l_pct));
        println!("{pot} {power_w} W: bias and deviation {r:?} % of R, {l:?} % of L");
        assert!(r.0.abs() < 0.15 && (0.004..0.04).contains(&r.1), "{r:?}");
        assert!(l.0.abs() < 0.03 && (0.002..0.015).contains(&l.1), "{l:?}");
    }
}
