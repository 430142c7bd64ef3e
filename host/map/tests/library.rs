//! A pot that one hob knows, on another one.

use std::sync::Arc;

use ihd_field::FieldModel;
use ihd_map::library::Library;
use ihd_map::{Curve, MeasuredPoint, PotMap, Provenance, Seen};
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, current_a, frequency_hz};
use ihd_signal::Load;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::pot::Pot;
use ihd_sim::surrogate::SurrogatePot;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A pot on one hob's coil.
struct Hob {
    table: SurrogatePot,
    gain: f64,
    winding_ohm: f64,
}

impl Hob {
    fn new(pot: &Pot, gain: f64, winding_ohm: f64) -> Self {
        let settings = pot.field_settings(0.0).unwrap();
        let models: Vec<_> = settings
            .into_iter()
            .map(|(w, s)| (w, FieldModel::new(&s).unwrap()))
            .collect();
        Self {
            table: SurrogatePot::new(&models).unwrap(),
            gain,
            winding_ohm,
        }
    }

    fn load(&self, f_hz: f64, i_a: f64) -> Load {
        let (r_ohm, l_h) = self.table.at(f_hz).r_l(i_a);
        Load {
            r_ohm: self.gain * (r_ohm + self.winding_ohm),
            l_h: self.gain * l_h,
        }
    }

    fn crest(&self, f_hz: f64) -> Option<(f64, f64)> {
        let drive_v = 2.0 / std::f64::consts::PI * 325.0;
        let omega = std::f64::consts::TAU * f_hz;
        let mut i_a = 25.0;
        for _ in 0..30 {
            let z = self.load(f_hz, i_a);
            let x = omega * z.l_h - 1.0 / (omega * 1080e-9);
            if x < 0.0 {
                return None;
            }
            i_a = 0.5 * (i_a + drive_v / z.r_ohm.hypot(x));
        }
        Some((i_a, 0.25 * self.load(f_hz, i_a).r_ohm * i_a * i_a))
    }

    fn at_power(&self, power_w: f64) -> f64 {
        let too_much = |f: &f64| self.crest(*f).is_none_or(|(_, p)| p > power_w);
        (31..80)
            .rev()
            .map(|k| 1e3 * f64::from(k))
            .find(too_much)
            .unwrap_or(31e3)
            + 1e3
    }

    fn window(&self, f_hz: f64, t_s: f64, rng: &mut ChaCha8Rng) -> Curve {
        let (most_a, _) = self.crest(f_hz).unwrap();
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let points: Vec<_> = (0..60)
            .map(|n| {
                let i_a = most_a * (std::f64::consts::PI * (f64::from(n) + 0.5) / 120.0).sin();
                let z = self.load(f_hz, i_a);
                let sigma = 0.003 * most_a / i_a;
                MeasuredPoint {
                    i_a,
                    r_ohm: z.r_ohm * (1.0 + sigma * normal()),
                    l_h: z.l_h * (1.0 + 0.5 * sigma * normal()),
                    r_sigma_ohm: z.r_ohm * sigma,
                    l_sigma_h: z.l_h * 0.5 * sigma,
                }
            })
            .collect();
        Curve::new(f_hz, t_s, points.into_iter())
    }

    /// mean and worst R, L; z; known
    fn judge(&self, map: &PotMap, now_s: f64) -> String {
        let cells = map.cells(now_s).unwrap();
        let (mut r, mut l, mut z, mut known, mut n) = (vec![], vec![], vec![], 0, 0);
        for (f, row) in cells.iter().enumerate().take(FREQUENCIES) {
            let Some((most_a, power_w)) = self.crest(frequency_hz(f)) else {
                continue;
            };
            for (i, cell) in row
                .iter()
                .enumerate()
                .take(CURRENTS)
                .take_while(|(i, _)| current_a(*i) <= most_a && power_w < 2500.0)
            {
                let truth = self.load(frequency_hz(f), current_a(i));
                let off = [
                    cell.value.r_ohm / truth.r_ohm - 1.0,
                    cell.value.l_h / truth.l_h - 1.0,
                ];
                n += 1;
                known += usize::from(cell.value.r_sigma <= 0.03 && cell.value.l_sigma <= 0.015);
                z.push((off[0] / cell.value.r_sigma).powi(2));
                z.push((off[1] / cell.value.l_sigma).powi(2));
                if !cell.is_observed() {
                    r.push(100.0 * off[0].abs());
                    l.push(100.0 * off[1].abs());
                }
            }
        }
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        let worst = |x: &[f64]| x.iter().copied().fold(0.0, f64::max);
        format!(
            "R {:.2}/{:.2} L {:.2}/{:.2} z {:.1} known {known}/{n}",
            mean(&r),
            worst(&r),
            mean(&l),
            worst(&l),
            mean(&z).sqrt()
        )
    }
}

#[test]
fn look() {
    let names = ["ferritic-21", "ferritic-18", "ferritic-12", "cast-iron-21"];
    for per in [
        Some(Perturbation::SharpKnee),
        Some(Perturbation::Tail),
        None,
    ] {
        let mut library = Library::default();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (k, name) in names.iter().enumerate() {
            let pot = Pot {
                perturbation: per,
                ..name.parse().unwrap()
            };
            let hob = Hob::new(&pot, 1.0, 0.1);
            let mut map = PotMap::default();
            for (n, power_w) in [700.0, 1200.0, 2000.0].into_iter().enumerate() {
                map.observe(hob.window(hob.at_power(power_w), n as f64, &mut rng));
            }
            map.refresh(3.0);
            let by = Provenance {
                hob: format!("hob-{k}"),
                build: "b".into(),
                t_unix_s: 1000 + k as u64,
            };
            let entry = map.entry(by);
            println!(
                "{name} {per:?}: {} {}",
                hob.judge(&map, 3.0),
                entry.is_some()
            );
            if let Some(e) = entry {
                println!("  {:?} {} B", e.misfit(), e.to_bytes().len());
                println!("{:?}", library.add(e).unwrap());
            }
        }
        println!("library {}", library.entries().len());
        let library = Arc::new(library);
        for name in names {
            for lift in [0.003] {
                let pot = Pot {
                    lift_m: lift,
                    perturbation: per,
                    ..name.parse().unwrap()
                };
                let hob = Hob::new(&pot, 1.01, 0.11);
                println!("{name} lift {lift} {per:?}");
                for power_w in [700.0, 2000.0] {
                    for library in [None, Some(library.clone())] {
                        let mut map = PotMap::default();
                        if let Some(l) = library {
                            map = map.with_library(l);
                        }
                        let mut rng = ChaCha8Rng::seed_from_u64(7);
                        let t = std::time::Instant::now();
                        map.observe(hob.window(hob.at_power(power_w), 0.0, &mut rng));
                        let t = t.elapsed();
                        let one = hob.judge(&map, 0.0);
                        let seen = map.observe(hob.window(hob.at_power(1200.0), 1.0, &mut rng));
                        println!(
                            "  {power_w} W: {one} | {} {:?} {t:?} {}",
                            hob.judge(&map, 1.0),
                            map.recognised().collect::<Vec<_>>(),
                            matches!(seen, Seen::Another { .. })
                        );
                    }
                }
            }
        }
    }
}
