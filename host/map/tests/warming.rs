//! A pot that is heated for ten minutes at changing powers stays one pot in the map, and another one is found as soon as ever:
//! tables of the field model in the frequency domain at the temperatures of a heat balance; time is that of the windows.

mod windows;

use ihd_field::FieldModel;
use ihd_map::{CurveMatch, PotMap};
use ihd_signal::Load;
use ihd_sim::contents::PotContents;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::surrogate::SurrogatePot;
use ihd_sim::thermal_model::ThermalModel;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Operating points: switching frequency in hertz and current at the crest in ampere, some 1.8, .4 and 1 kW.
const POINTS: [(f64, f64); 3] = [(46e3, 40.0), (60e3, 18.0), (52e3, 28.0)];

/// Time at each operating point in seconds, and steps between the tables in kelvin.
const AT_EACH_S: u32 = 45;
const STEP_K: f64 = 20.0;

fn table(pot: SimulatedPot, temperature_c: f64) -> SurrogatePot {
    let hot = SimulatedPot {
        temperature_c,
        ..pot
    };
    let settings = hot.field_settings(0.1).unwrap();
    let models: Vec<_> = settings
        .into_iter()
        .map(|(weight, s)| (weight, FieldModel::new(&s).unwrap()))
        .collect();
    SurrogatePot::new(&models).unwrap()
}

/// Tables of one pot at rising temperatures, filled when they are needed.
struct HotPot {
    pot: SimulatedPot,
    tables: Vec<SurrogatePot>,
}

impl HotPot {
    fn load(&mut self, temperature_c: f64, f_hz: f64) -> impl Fn(f64) -> Load + use<> {
        let x = (temperature_c - self.pot.temperature_c) / STEP_K;
        while self.tables.len() < x as usize + 2 {
            let to_c = self.pot.temperature_c + STEP_K * self.tables.len() as f64;
            self.tables.push(table(self.pot, to_c));
        }
        let share = x - x.floor();
        let [below, above] = [0, 1].map(|k| self.tables[x as usize + k].at(f_hz));
        move |i_a| {
            let (below, above) = (below.r_l(i_a), above.r_l(i_a));
            Load {
                r_ohm: below.0 + share * (above.0 - below.0),
                l_h: below.1 + share * (above.1 - below.1),
            }
        }
    }
}

/// Errors of R and L in percent and in their deviations.
#[derive(Default)]
struct Judged {
    pct: [Vec<f64>; 2],
    z: Vec<f64>,
}

impl Judged {
    fn add(&mut self, map: &PotMap, now_s: f64, (f_hz, i_a): (f64, f64), truth: Load) {
        let found = map.at(f_hz, &[i_a], now_s)[0];
        let off = [found.r_ohm / truth.r_ohm - 1.0, found.l_h / truth.l_h - 1.0];
        for (x, sigma) in [found.r_sigma, found.l_sigma].into_iter().enumerate() {
            self.pct[x].push(100.0 * off[x]);
            self.z.push(off[x] / sigma);
        }
    }

    /// Root mean squares of R and L in percent, and of both in deviations.
    fn rms(&self) -> [f64; 3] {
        [&self.pct[0], &self.pct[1], &self.z]
            .map(|x| (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt())
    }
}

#[test]
fn a_pot_heated_for_ten_minutes_is_one_pot_and_a_lifted_one_another_at_once() {
    for contents in [PotContents::Food, PotContents::Water(1.0)] {
        heated(contents);
    }
}

fn heated(contents: PotContents) {
    let pot: SimulatedPot = "ferritic-18".parse().unwrap();
    let mut hot = HotPot {
        pot,
        tables: Vec::new(),
    };
    let mut thermal = ThermalModel::new(contents, &pot);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut map = PotMap::default();
    let (mut here, mut elsewhere) = (Judged::default(), Judged::default());
    let mut now_s = 0.0;
    for second in 0..600 {
        let now = (second / AT_EACH_S) as usize % POINTS.len();
        let (f_hz, most_a) = POINTS[now];
        let base_c = thermal.temperature_c();
        let load = hot.load(base_c, f_hz);
        now_s = f64::from(second);
        let known = map.curves().len();
        let seen = map.observe(windows::window((f_hz, most_a), now_s, &load, &mut rng));
        let same = matches!(seen, CurveMatch::First | CurveMatch::Same { .. });
        assert!(same, "{contents:?}, {second} s, {base_c:.0} °C: {seen:?}");
        assert!(map.curves().len() >= known);
        thermal.advance(0.25 * load(most_a).r_ohm * most_a * most_a, 1.0);
        let all = second >= AT_EACH_S * POINTS.len() as u32;
        if all && second % 5 == 0 {
            let mut map = map.clone();
            map.refresh(now_s);
            for (k, (f_hz, most_a)) in POINTS.into_iter().enumerate() {
                let judged = if k == now { &mut here } else { &mut elsewhere };
                for i_a in [0.4 * most_a, most_a] {
                    let truth = hot.load(base_c, f_hz)(i_a);
                    judged.add(&map, now_s, (f_hz, i_a), truth);
                }
            }
        }
    }
    let (here, elsewhere, base_c) = (here.rms(), elsewhere.rms(), thermal.temperature_c());
    println!(
        "{contents:?} to {base_c:.0} °C: R, L in %, z: here {here:.3?}, at frequencies seen 45 s ago and more {elsewhere:.3?}"
    );
    assert!(here[0] < 0.2 && here[1] < 0.1, "{here:?}");
    assert!(elsewhere[0] < 0.5 && elsewhere[1] < 0.25, "{elsewhere:?}");
    for z in [here[2], elsewhere[2]] {
        assert!((0.3..1.5).contains(&z), "{z}");
    }
    let lifted = SimulatedPot {
        lift_m: pot.lift_m + 0.5e-3,
        ..pot
    };
    let lifted = table(lifted, base_c);
    for (f_hz, most_a) in POINTS {
        let mut map = map.clone();
        let load = |i_a: f64| {
            let (r_ohm, l_h) = lifted.at(f_hz).r_l(i_a);
            Load { r_ohm, l_h }
        };
        let seen = map.observe(windows::window((f_hz, most_a), now_s + 5.0, load, &mut rng));
        assert!(matches!(seen, CurveMatch::Another { .. }), "{seen:?}");
        assert_eq!(map.curves().len(), 1);
    }
}
