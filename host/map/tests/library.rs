//! A pot that one hob knows, on another one: against tables of the field model in the frequency domain, which share the gap with
//! the map and no metal; `ihd-study pots` judges with waveforms, converters and the network.

mod windows;

use std::sync::Arc;

use ihd_field::FieldModel;
use ihd_map::library::{Library, shape_places};
use ihd_map::{CurrentCurve, CurveMatch, PotEntry, PotMap, Provenance};
use ihd_shared::lookup::grid::{CURRENTS, current_a, frequency_hz};
use ihd_signal::Load;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::surrogate::SurrogatePot;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A pot on one hob's coil.
struct Hob {
    table: SurrogatePot,
    gain: f64,
    winding_r_ohm: f64,
}

/// Errors over the cells that this hob reaches.
struct Judged {
    /// Means over unseen cells in percent.
    r_pct: f64,
    l_pct: f64,
    z_rms: f64,
    /// Largest relative error where the lookup would mark a cell, over the deviation from which it does not.
    worst_marked: f64,
}

impl Hob {
    fn new(name: &str, lift_m: f64, gain: f64, winding_r_ohm: f64) -> Self {
        let pot = SimulatedPot {
            lift_m,
            ..name.parse().unwrap()
        };
        let settings = pot.field_settings(0.0).unwrap();
        let models: Vec<_> = settings
            .into_iter()
            .map(|(weight, s)| (weight, FieldModel::new(&s).unwrap()))
            .collect();
        Self {
            table: SurrogatePot::new(&models).unwrap(),
            gain,
            winding_r_ohm,
        }
    }

    /// The hob that knows the pot.
    fn first(name: &str) -> Self {
        Self::new(name, 0.0, 1.0, 0.1)
    }

    /// The one that has never seen it: thicker glass, warmer winding, another sensor.
    fn second(name: &str) -> Self {
        Self::new(name, 1e-3, 1.01, 0.11)
    }

    fn load(&self, f_hz: f64, i_a: f64) -> Load {
        let (r_ohm, l_h) = self.table.at(f_hz).r_l(i_a);
        Load {
            r_ohm: self.gain * (r_ohm + self.winding_r_ohm),
            l_h: self.gain * l_h,
        }
    }

    /// Amplitude of the current at the crest of 230 V in ampere, and the mean power in watt; `None` below resonance.
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

    /// A window at the frequency where the hob takes this power in watt, at 40 dB.
    fn window(&self, power_w: f64, t_s: f64, rng: &mut ChaCha8Rng) -> CurrentCurve {
        let too_much = |f: &f64| self.crest(*f).is_none_or(|(_, p)| p > power_w);
        let stepping = (31..80).rev().map(|k| 1e3 * f64::from(k));
        let f_hz = stepping.clone().find(too_much).unwrap_or(31e3) + 1e3;
        let (most_a, _) = self.crest(f_hz).expect("above resonance");
        windows::window((f_hz, most_a), t_s, |i_a| self.load(f_hz, i_a), rng)
    }

    fn judge(&self, map: &PotMap, now_s: f64) -> Judged {
        let cells = map.cells(now_s).unwrap();
        let (mut r, mut l, mut squares, mut worst_marked) = (vec![], vec![], vec![], 0.0);
        for (f, row) in cells.iter().enumerate() {
            let Some((most_a, power_w)) = self.crest(frequency_hz(f)) else {
                continue;
            };
            for i in (0..CURRENTS).take_while(|i| current_a(*i) <= most_a && power_w < 2500.0) {
                let (truth, value) = (self.load(frequency_hz(f), current_a(i)), row[i].value);
                let off = [value.r_ohm / truth.r_ohm - 1.0, value.l_h / truth.l_h - 1.0];
                squares.push((off[0] / value.r_sigma).powi(2));
                squares.push((off[1] / value.l_sigma).powi(2));
                if value.r_sigma <= 0.03 && value.l_sigma <= 0.015 {
                    worst_marked = (off[0].abs() / 0.03)
                        .max(off[1].abs() / 0.015)
                        .max(worst_marked);
                }
                if !row[i].is_observed() {
                    r.push(100.0 * off[0].abs());
                    l.push(100.0 * off[1].abs());
                }
            }
        }
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        assert!(r.len() > 9);
        Judged {
            r_pct: mean(&r),
            l_pct: mean(&l),
            z_rms: mean(&squares).sqrt(),
            worst_marked,
        }
    }
}

fn by(hob: &str) -> Provenance {
    Provenance {
        hob: hob.into(),
        build: "test".into(),
        t_unix_s: 1_700_000_000,
    }
}

fn taught(hob: &Hob, map: PotMap, powers_w: &[f64], seed: u64) -> (PotMap, f64) {
    let (mut map, mut now_s) = (map, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for (k, power_w) in powers_w.iter().enumerate() {
        now_s = k as f64;
        let seen = map.observe(hob.window(*power_w, now_s, &mut rng));
        assert!(!matches!(seen, CurveMatch::Another { .. }), "{seen:?}");
    }
    map.refresh(now_s);
    (map, now_s)
}

fn known(name: &str) -> PotEntry {
    let powers_w = [500.0, 700.0, 1000.0, 1400.0, 2000.0];
    let (map, _) = taught(&Hob::first(name), PotMap::default(), &powers_w, 1);
    map.entry(by(&format!("knows-{name}"))).expect("well known")
}

fn shelf(entries: impl IntoIterator<Item = PotEntry>) -> Arc<Library> {
    let mut library = Library::default();
    for entry in entries {
        library.add(entry).unwrap();
    }
    Arc::new(library)
}

fn with(library: &Arc<Library>) -> PotMap {
    PotMap::default().with_library(library.clone())
}

#[test]
fn an_empty_library_changes_no_digit() {
    let hob = Hob::second("ferritic-15");
    for powers_w in [&[1200.0][..], &[700.0, 1200.0, 2000.0]] {
        let (plain, now_s) = taught(&hob, PotMap::default(), powers_w, 3);
        let (empty, _) = taught(&hob, with(&shelf([])), powers_w, 3);
        assert_eq!(plain.cells(now_s), empty.cells(now_s));
        let bytes = |map: &PotMap| serde_json::to_string(&map.state()).unwrap();
        assert_eq!(bytes(&plain), bytes(&empty));
        // What a build before the library wrote and reads.
        assert!(!bytes(&plain).contains("recognised") && !bytes(&plain).contains("spread"));
        assert_eq!(empty.recognised().count(), 0);
    }
}

#[test]
fn a_known_pot_is_recognised_on_another_hob_and_its_inductance_known_better() {
    let names = ["ferritic-21", "ferritic-15", "cast-iron-21"];
    let library = shelf(names.map(known));
    let (mut with_l, mut without_l) = (0.0, 0.0);
    for name in names {
        let hob = Hob::second(name);
        let (map, now_s) = taught(&hob, with(&library), &[2000.0], 5);
        let (likeliest, share) = map
            .recognised()
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .expect("recognised");
        assert!(
            likeliest.starts_with(&format!("knows-{name}-")),
            "{likeliest}"
        );
        assert!(share > 0.25 && share <= 0.5 + 1e-9, "{share}");
        let is = hob.judge(&map, now_s);
        let (plain, _) = taught(&hob, PotMap::default(), &[2000.0], 5);
        let was = hob.judge(&plain, now_s);
        println!(
            "{name}: R {:.2} -> {:.2}, L {:.2} -> {:.2} %, z {:.1}",
            was.r_pct, is.r_pct, was.l_pct, is.l_pct, is.z_rms
        );
        with_l += is.l_pct;
        without_l += was.l_pct;
        assert!(is.r_pct < 2.0 && is.l_pct < 1.0 && is.z_rms < 2.0);
    }
    // Gap, turns and radius, which one window cannot tell apart, are half known.
    assert!(with_l < 0.8 * without_l, "{with_l} {without_l}");
}

#[test]
fn pots_that_it_is_not_leave_the_map_as_good_as_it_was() {
    let library = shelf(["ferritic-21", "ferritic-12", "cast-iron-21"].map(known));
    for name in ["ferritic-17", "cast-iron-16"] {
        let hob = Hob::second(name);
        for powers_w in [&[2000.0][..], &[700.0], &[1200.0, 700.0, 2000.0]] {
            let (map, now_s) = taught(&hob, with(&library), powers_w, 6);
            let (plain, _) = taught(&hob, PotMap::default(), powers_w, 6);
            let (is, was) = (hob.judge(&map, now_s), hob.judge(&plain, now_s));
            let shares: Vec<_> = map.recognised().collect();
            println!(
                "{name} {powers_w:?}: R {:.2} -> {:.2}, L {:.2} -> {:.2} %, z {:.1} {shares:?}",
                was.r_pct, is.r_pct, was.l_pct, is.l_pct, is.z_rms
            );
            assert!(is.r_pct < was.r_pct + 0.5 && is.l_pct < was.l_pct + 0.25);
            assert!(is.z_rms < 2.0, "{}", is.z_rms);
        }
    }
}

/// An entry that fits the first window at whatever current and is off by up to `r` and `l` an octave away.
fn lie(entry: &PotEntry, first_hz: f64, r: f64, l: f64) -> PotEntry {
    let mut lie: serde_json::Value = serde_json::from_slice(&entry.to_bytes()).unwrap();
    let places = shape_places();
    for (k, code) in lie["shape"].as_array_mut().unwrap().iter_mut().enumerate() {
        let away = if k < places.len() { r } else { l };
        let octaves = (places[k % places.len()].0 / first_hz).log2();
        let shift = (away * octaves * 1e5).round() as i64;
        *code = (code.as_i64().unwrap() + shift).into();
    }
    lie["misfit"] = serde_json::json!([0.06, 0.02]);
    PotEntry::from_bytes(&serde_json::to_vec(&lie).unwrap()).unwrap()
}

/// Root mean square of a map's shift beside another's, in the other's own deviations, over all of a pot's places.
fn shift_in_sigmas(map: &PotMap, plain: &PotMap, now_s: f64) -> f64 {
    let places = shape_places();
    let squares: f64 = places
        .iter()
        .map(|&(f_hz, i_a)| {
            let at = |map: &PotMap| map.at(f_hz, &[i_a], now_s)[0];
            let (is, was) = (at(map), at(plain));
            let r = (is.r_ohm / was.r_ohm).ln() / was.r_sigma.hypot(0.004);
            let l = (is.l_h / was.l_h).ln() / was.l_sigma.hypot(0.002);
            (r * r + l * l) / 2.0
        })
        .sum();
    (squares / places.len() as f64).sqrt()
}

/// The largest of lies that are believed: whatever they are, marked cells stay near the truth, and the second frequency ends it.
#[test]
fn small_lies_do_little_and_not_for_long() {
    let hob = Hob::second("ferritic-18");
    let honest = known("ferritic-18");
    let (plain, now_s) = taught(&hob, PotMap::default(), &[1200.0], 7);
    let first_hz = plain.curves()[0].f_sw_hz;
    let alone = hob.judge(&plain, now_s);
    let mut believed = 0;
    for an_octave in [0.0, 0.02, 0.04, 0.06, 0.08, -0.03, -0.06] {
        let library = shelf([lie(&honest, first_hz, an_octave, 0.3 * an_octave)]);
        let (fooled, now_s) = taught(&hob, with(&library), &[1200.0], 7);
        let is = hob.judge(&fooled, now_s);
        let shares: Vec<_> = fooled.recognised().map(|(_, share)| share).collect();
        println!(
            "{an_octave} an octave: R {:.2}, L {:.2} %, z {:.1}, worst marked {:.2}, {shares:?}",
            is.r_pct, is.l_pct, is.z_rms, is.worst_marked
        );
        believed += usize::from(!shares.is_empty());
        let shift = shift_in_sigmas(&fooled, &plain, now_s);
        assert!(shift <= 1.0, "{shift} deviations");
        assert!(is.worst_marked < 2.0, "{}", is.worst_marked);
        let powers_w = [1200.0, 700.0, 2000.0];
        let (map, now_s) = taught(&hob, with(&library), &powers_w, 7);
        let is = hob.judge(&map, now_s);
        assert!(
            is.r_pct < alone.r_pct + 0.5 && is.z_rms < 2.0,
            "{} {}",
            is.r_pct,
            is.z_rms
        );
    }
    assert!(believed > 0);
}

#[test]
fn a_lie_that_fits_the_first_window_only_is_not_believed() {
    let hob = Hob::second("ferritic-18");
    let (plain, _) = taught(&hob, PotMap::default(), &[1200.0], 7);
    let first_hz = plain.curves()[0].f_sw_hz;
    let library = shelf([lie(&known("ferritic-18"), first_hz, 0.15, 0.05)]);
    let (fooled, now_s) = taught(&hob, with(&library), &[1200.0], 7);
    let is = hob.judge(&fooled, now_s);
    println!(
        "one window: R {:.2}, L {:.2} %, z {:.1}, worst marked {:.2}",
        is.r_pct, is.l_pct, is.z_rms, is.worst_marked
    );
    // What it says of other frequencies is beyond what this hob believes of any pot after one window.
    assert_eq!(fooled.recognised().count(), 0);
    assert!(
        is.worst_marked < 1.0 && is.z_rms < 2.0,
        "{}",
        is.worst_marked
    );
    // `taught` checks that the pot is not taken for another one.
    let powers_w = [1200.0, 700.0, 2000.0];
    let (map, now_s) = taught(&hob, with(&library), &powers_w, 7);
    let (plain, _) = taught(&hob, PotMap::default(), &powers_w, 7);
    let (is, was) = (hob.judge(&map, now_s), hob.judge(&plain, now_s));
    println!(
        "three: R {:.2}, L {:.2} %, z {:.1}",
        is.r_pct, is.l_pct, is.z_rms
    );
    assert_eq!(map.recognised().count(), 0);
    assert!((is.r_pct - was.r_pct).abs() < 1e-9 && (is.l_pct - was.l_pct).abs() < 1e-9);
}

#[test]
fn what_is_kept_gives_the_same_cells_without_the_library() {
    let library = shelf([known("ferritic-18")]);
    let hob = Hob::second("ferritic-18");
    let (map, now_s) = taught(&hob, with(&library), &[1200.0, 700.0], 8);
    assert_eq!(map.recognised().count(), 1);
    let kept = serde_json::to_string(&map.state()).unwrap();
    let restored = PotMap::from_state(serde_json::from_str(&kept).unwrap()).unwrap();
    assert_eq!(restored.cells(now_s), map.cells(now_s));
    for (from, to) in [
        ("\"share\":0.5", "\"share\":1.5"),
        ("\"share\":0.5", "\"share\":-0.5"),
    ] {
        let lie = kept.replacen(from, to, 1);
        assert_ne!(lie, kept);
        assert!(PotMap::from_state(serde_json::from_str(&lie).unwrap()).is_none());
    }
}

#[test]
fn what_came_from_the_library_is_not_told_on() {
    let hob = Hob::second("ferritic-18");
    let powers_w = [700.0, 1200.0, 2000.0];
    let (map, _) = taught(&hob, with(&shelf([known("ferritic-18")])), &powers_w, 9);
    let (plain, _) = taught(&hob, PotMap::default(), &powers_w, 9);
    assert!(map.recognised().count() > 0);
    assert_eq!(map.entry(by("hob-2")), plain.entry(by("hob-2")));
    assert!(plain.entry(by("hob-2")).is_some());
    // Of one window nothing is told, and not under a name that no hob has.
    let (one, _) = taught(&hob, PotMap::default(), &[1200.0], 9);
    assert_eq!(one.entry(by("hob-2")), None);
    assert_eq!(plain.entry(by("hob 2/…")), None);
}
