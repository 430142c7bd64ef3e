use super::*;
use crate::behavioural::{BehaviouralLoad, PotKind};
use crate::pot::PotBase;
use crate::recording::prepared::field_models;
use crate::surrogate::exact;
use ihd_field::harmonic;

fn load(kind: LoadKind, pot: SimulatedPot) -> TrueLoad {
    TrueLoad::new(kind, &pot, None).unwrap()
}

fn off_pct(is: f64, of: f64) -> f64 {
    100.0 * (is / of - 1.0).abs()
}

#[test]
fn a_laws_cells_are_the_law() {
    let map = load(LoadKind::Behavioural, PotKind::Ferromagnetic.into())
        .map(&mut |_| ())
        .unwrap();
    assert!(map.reached() > 40, "{}", map.reached());
    for (f, row) in map.cells.iter().enumerate() {
        let law = BehaviouralLoad::new(PotKind::Ferromagnetic, frequency_hz(f));
        for (i, cell) in row.iter().enumerate() {
            let Some(z) = cell else { continue };
            let (r, l) = law.r_l(current_a(i));
            assert!(
                off_pct(z.r_ohm, r) < 0.01 && off_pct(z.l_h, l) < 0.01,
                "{f} {i}"
            );
        }
    }
    // Below the hob's lowest frequency, and beyond any current that it plans with.
    assert!(map.cells[0].iter().all(Option::is_none));
    assert!(map.cells.iter().all(|row| row[16].is_none()));
}

/// The closed form of crest and power against the half-bridge in the time domain with the same law.
#[test]
fn a_laws_crest_and_power_are_the_half_bridges() {
    let law = load(LoadKind::Behavioural, PotKind::Ferromagnetic.into());
    for f_sw_hz in [45e3, 60e3, 80e3] {
        let (still, run) = (law.law(f_sw_hz).unwrap(), law.waveform(f_sw_hz).unwrap());
        println!(
            "{f_sw_hz}: {:.2} A {:.0} W, {:.2} A {:.0} W",
            still.crest_a(),
            still.power_w,
            run.crest_a(),
            run.power_w
        );
        assert!(off_pct(still.crest_a(), run.crest_a()) < 2.0);
        assert!(off_pct(still.power_w, run.power_w) < 5.0);
        for i_a in [0.0, 2.0, 10.0] {
            let (a, b) = (still.at(i_a).unwrap(), run.at(i_a).unwrap());
            // The envelope that the law follows is half a period late, on both flanks' mean not at all.
            assert!(off_pct(b.r_ohm, a.r_ohm) < 0.5, "{i_a} A: {a:?} {b:?}");
            assert!(off_pct(b.l_h, a.l_h) < 0.5, "{i_a} A: {a:?} {b:?}");
        }
    }
}

/// The waveform is its own solver: exact where the describing function is, at no current, and off by the
/// harmonics' few percent at large ones (docs/simulator.md).
#[test]
fn the_fields_truth_is_the_waveforms() {
    let pot = SimulatedPot::new(PotBase::Ferritic, 0.18);
    let field = load(LoadKind::Field, pot);
    let PreparedLoad::Field(models) = &field.prepared else {
        panic!("a field model");
    };
    let model = &models[0].1;
    let curve = field.curve(52e3).unwrap();
    let z = |i_a| harmonic::impedance(model, 52e3, i_a).unwrap();
    let (still, zero) = (z(0.0), curve.at(0.0).unwrap());
    println!("{still:?} {zero:?}");
    assert!(off_pct(zero.r_ohm, still.r_ohm) < 0.6, "{zero:?} {still:?}");
    assert!(off_pct(zero.l_h, still.l_h) < 0.3, "{zero:?} {still:?}");
    let mut worst: f64 = 0.0;
    for i_a in [2.0, 10.0, 25.0] {
        let (sine, wave) = (z(i_a), curve.at(i_a).unwrap());
        println!("{i_a} A: {sine:?} {wave:?}");
        assert!(off_pct(wave.r_ohm, sine.r_ohm) < 6.0 && off_pct(wave.l_h, sine.l_h) < 3.0);
        worst = worst.max(off_pct(wave.r_ohm, sine.r_ohm));
    }
    assert!(worst > 0.5, "it is the describing function: {worst} %");
    assert!(curve.at(curve.crest_a() + 1.0).is_none());
}

#[test]
fn what_the_hob_does_not_heat_is_not_reached() {
    let of = |pot| load(LoadKind::Surrogate, pot).map(&mut |_| ()).unwrap();
    for pot in [
        SimulatedPot::NONE,
        SimulatedPot::new(PotBase::Aluminium, 0.21),
        SimulatedPot::new(PotBase::Stainless, 0.21),
    ] {
        assert_eq!(of(pot).reached(), 0, "{pot}");
    }
    // Rows are whole: from zero current to the crest, without holes.
    for cm in [12.0, 21.0] {
        let map = of(SimulatedPot::new(PotBase::Ferritic, cm * 1e-2));
        println!("{cm} cm: {} cells", map.reached());
        assert!(map.reached() > 20);
        for row in &map.cells {
            let n = row.iter().flatten().count();
            assert!(row[..n].iter().all(Option::is_some));
        }
    }
}

#[test]
fn an_asked_power_is_taken_where_no_limit_forbids_it() {
    let full = load(
        LoadKind::Surrogate,
        SimulatedPot::new(PotBase::Ferritic, 0.21),
    );
    for power_w in [1200.0, 2000.0] {
        let curve = full.heated_with(power_w).unwrap();
        assert!(off_pct(curve.power_w, power_w) < 1.0, "{}", curve.power_w);
        assert_eq!(curve.reach(), Reach::Used);
    }
    // A small pot gets half of the rating at most.
    let small = load(
        LoadKind::Surrogate,
        SimulatedPot::new(PotBase::Ferritic, 0.12),
    );
    let curve = small.heated_with(2000.0).unwrap();
    println!("{} W at {} Hz", curve.power_w, curve.f_sw_hz);
    assert!(curve.power_w <= 1250.0 && curve.reach() == Reach::Used);
}

#[test]
fn heat_bends_the_truth_as_the_hobs() {
    let pot = SimulatedPot::new(PotBase::Ferritic, 0.21);
    let at = |warm_c| {
        let load = TrueLoad::new(LoadKind::Surrogate, &pot, warm_c).unwrap();
        load.curve(50e3).unwrap().at(10.0).unwrap()
    };
    let ratio = at(Some(120.0)).r_ohm / at(None).r_ohm;
    // The field model itself at that temperature: resistivity and saturation, some 3 % a 100 K.
    let field = |temperature_c| {
        let hot = SimulatedPot {
            temperature_c,
            ..pot
        };
        let models = field_models(&hot, WINDING_R_OHM).unwrap();
        exact(&models, 50e3, 10.0).unwrap().r_ohm
    };
    let expected = field(120.0) / field(20.0);
    assert!(off_pct(ratio, expected) < 0.05, "{ratio} {expected}");
}
