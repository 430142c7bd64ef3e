use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

use super::*;
use crate::PotModel;

/// Deviations of a pot that three windows have shown.
const SIGMA: [f64; COUNT] = [0.04, 0.04, 2e-3, 1e-3, 0.015, 0.01, 0.02];

fn by(hob: &str, t_unix_s: u64) -> Provenance {
    Provenance {
        hob: hob.into(),
        build: "1.0.0".into(),
        t_unix_s,
    }
}

fn sample_fit(model: PotModel, sigma: [f64; COUNT]) -> ExportedFit {
    ExportedFit {
        model,
        factor: DMatrix::from_diagonal(&DVector::from(sigma.to_vec())),
        misfit: [0.004, 0.002],
        beside: DVector::from_element(2 * shape_places().len(), 1e-3),
        seen: MeasuredRange {
            f_sw_hz: [45e3, 70e3],
            i_a: [0.5, 50.0],
            curves: 3,
            windows: 9,
        },
    }
}

fn entry(hob: &str, t_unix_s: u64, change: impl Fn(&mut PotModel)) -> PotEntry {
    let mut model = PotModel::PAPER;
    change(&mut model);
    PotEntry::from_fit(&sample_fit(model, SIGMA), by(hob, t_unix_s)).expect("a sound entry")
}

#[test]
fn an_entry_goes_round_through_few_bytes() {
    let entry = entry("hob-1", 7, |_| ()).labelled("Großmutters Topf");
    let bytes = entry.to_bytes();
    assert!(bytes.len() < MAX_ENTRY_BYTES, "{}", bytes.len());
    let back = PotEntry::from_bytes(&bytes).unwrap();
    assert_eq!(back, entry);
    assert_eq!(
        (back.id(), back.label()),
        ("hob-1-7", Some("Großmutters Topf"))
    );
    assert_eq!(back.metal(), MetalClass::Ferritic);
    let (diameter_m, sigma_m) = back.diameter_m();
    assert!((diameter_m - 0.21).abs() < 1e-12 && (sigma_m - 4e-3).abs() < 1e-9);
    let mut library = Library::default();
    library.add(entry).unwrap();
    assert_eq!(Library::from_bytes(&library.to_bytes()).unwrap(), library);
}

#[test]
fn lies_are_refused_and_named() {
    let text = String::from_utf8(entry("hob-1", 7, |_| ()).to_bytes()).unwrap();
    let many = format!("\"hobs\":[{}]", ["\"a\""; 9].join(","));
    let long = format!("\"build\":\"{}\"", "x".repeat(49));
    for (from, to, says) in [
        ("{", "", "cannot be read"),
        ("\"version\":1", "\"version\":2", "layout 2"),
        (
            "\"radius_m\":0.105",
            "\"radius_m\":1e9",
            "number of the pot",
        ),
        (
            "\"radius_m\":0.105",
            "\"radius_m\":-0.1",
            "number of the pot",
        ),
        ("\"radius_m\":0.105", "\"radius_m\":null", "cannot be read"),
        ("\"radius_m\":0.105", "\"radius_m\":1e999", "e"),
        ("\"factor\":[0.04", "\"factor\":[-0.04", "a deviation"),
        ("\"factor\":[0.04", "\"factor\":[0.0", "a deviation"),
        ("\"factor\":[0.04", "\"factor\":[1e300", "a deviation"),
        ("\"factor\":[0.04", "\"factor\":[0.04,0.04", "a deviation"),
        ("\"misfit\":[0.004", "\"misfit\":[0.0", "misfit"),
        ("\"shape\":[100", "\"shape\":[32767", "shape"),
        ("\"shape\":[100", "\"shape\":[100,100", "shape"),
        ("\"shape\":[100", "\"shape\":[99999", "cannot be read"),
        ("[45000.0,70000.0]", "[70000.0,45000.0]", "seen at"),
        ("[0.5,50.0]", "[-0.5,50.0]", "seen at"),
        ("\"hobs\":[\"hob-1\"]", "\"hobs\":[]", "name"),
        ("\"hobs\":[\"hob-1\"]", "\"hobs\":[\"../etc\"]", "name"),
        ("\"hobs\":[\"hob-1\"]", &many, "names"),
        ("\"build\":\"1.0.0\"", &long, "name"),
        ("\"label\":null", "\"label\":\"\\u0007\"", "names"),
    ] {
        let lie = text.replacen(from, to, 1);
        assert_ne!(lie, text, "{from}");
        let why = PotEntry::from_bytes(lie.as_bytes())
            .unwrap_err()
            .to_string();
        assert!(why.contains(says), "{to}: {why}");
        let shelf = format!("{{\"version\":1,\"entries\":[{lie}]}}");
        assert!(Library::from_bytes(shelf.as_bytes()).is_err(), "{to}");
    }
    let padded = text + &" ".repeat(MAX_ENTRY_BYTES);
    assert!(PotEntry::from_bytes(padded.as_bytes()).is_err());
    let huge = vec![b' '; MAX_ENTRIES * MAX_ENTRY_BYTES + 1];
    assert!(matches!(
        Library::from_bytes(&huge),
        Err(LibraryError::TooLarge { .. })
    ));
    let later = br#"{"version":2,"entries":[]}"#;
    assert!(matches!(
        Library::from_bytes(later),
        Err(LibraryError::Version(2))
    ));
}

#[test]
fn one_pot_seen_by_two_hobs_is_one_entry_and_two_pots_are_two() {
    let mut library = Library::default();
    let first = entry("hob-1", 1, |_| ());
    assert_eq!(library.add(first.clone()).unwrap(), Addition::New);
    let again = entry("hob-2", 2, |m| m.ln_alpha += 0.06);
    assert_eq!(
        library.add(again.clone()).unwrap(),
        Addition::Merged("hob-1-1".into())
    );
    let merged = &library.entries()[0];
    let mean = merged.model().ln_alpha - PotModel::PAPER.ln_alpha;
    assert!((mean - 0.03).abs() < 0.01, "{mean}");
    assert_eq!(merged.hobs(), ["hob-1", "hob-2"]);
    // The same hobs again say nothing new.
    let before = library.clone();
    assert_eq!(
        library.add(again).unwrap(),
        Addition::Repeated("hob-1-1".into())
    );
    assert_eq!(
        library.add(first).unwrap(),
        Addition::Repeated("hob-1-1".into())
    );
    assert_eq!(library, before);
    // 18 cm are no 21 cm, and cast iron is no steel.
    let smaller = entry("hob-2", 3, |m| m.radius_m = 0.09);
    let iron = entry("hob-2", 4, |m| m.ln_alpha = 5_500.0_f64.ln());
    assert_eq!(library.add(smaller).unwrap(), Addition::New);
    assert_eq!(library.add(iron).unwrap(), Addition::New);
    assert_eq!(library.entries().len(), 3);
    assert_eq!(library.entries()[2].metal(), MetalClass::CastIron);
}

#[test]
fn who_is_certain_of_himself_counts_no_more_than_the_transfer_allows() {
    let mut library = Library::default();
    library.add(entry("honest", 1, |_| ())).unwrap();
    let certain = SIGMA.map(|s| 1e-3 * s);
    let lie = PotModel {
        ln_alpha: PotModel::PAPER.ln_alpha + 0.15,
        ..PotModel::PAPER
    };
    for k in 0..50 {
        let lie = PotEntry::from_fit(&sample_fit(lie, certain), by("liar", 2 + k)).unwrap();
        let _ = library.add(lie).unwrap();
    }
    // By the transfer's 0.06 on both sides and the honest one's own 0.04 less than .6 of the way, however often it is said.
    let moved = library.entries()[0].model().ln_alpha - PotModel::PAPER.ln_alpha;
    assert!((0.0..0.6 * 0.15).contains(&moved), "{moved}");
    assert_eq!(library.entries()[0].hobs(), ["honest", "liar"]);
}

#[test]
fn one_hob_that_sends_many_makes_room_among_its_own() {
    let mut library = Library::default();
    let radius_m = |k: u64| 0.03 + 9e-3 * (k % 11) as f64;
    let ln_alpha = |k: u64| 6.5 + 0.6 * (k / 11) as f64;
    for k in 0..11 {
        let own = entry("honest", k, |m| {
            (m.radius_m, m.ln_alpha) = (radius_m(k), 5.9)
        });
        assert_eq!(library.add(own).unwrap(), Addition::New);
    }
    for k in 0..110 {
        let spam = entry("spam", 100 + k, |m| {
            (m.radius_m, m.ln_alpha) = (radius_m(k), ln_alpha(k));
        });
        library.add(spam).unwrap();
        let of_spam = library.entries().iter().filter(|e| e.hobs()[0] == "spam");
        assert!(of_spam.count() <= MAX_OF_ONE_HOB);
    }
    let honest = library.entries().iter().filter(|e| e.hobs()[0] == "honest");
    assert_eq!(honest.count(), 11);
    // Many hobs with as many each: the limit of all holds.
    for hob in 0..20 {
        for k in 0..10 {
            let own = entry(&format!("hob-{hob}"), k, |m| {
                (m.radius_m, m.ln_alpha) = (radius_m(k), 6.5);
                m.ln_s = -15.9 + 0.33 * f64::from(hob);
            });
            library.add(own).unwrap();
            assert!(library.entries().len() <= MAX_ENTRIES);
        }
    }
    assert!(library.to_bytes().len() <= MAX_ENTRIES * MAX_ENTRY_BYTES);
}

/// One window of the paper's pot.
fn window() -> Vec<Datum> {
    let at = |k: i32| {
        let i_a = 2.0 + 3.0 * f64::from(k);
        let z = PotModel::PAPER.impedance(55e3, i_a);
        Datum {
            f_hz: 55e3,
            i_a,
            ln: [z.r_ohm.ln(), z.l_h.ln()],
            variance: [1e-6, 1e-6],
            level: [0.0; 2],
            common: [0.0; 2],
            age_s: 0.0,
        }
    };
    (0..12).map(at).collect()
}

#[test]
fn the_pot_is_the_first_candidate_and_no_more_are_fitted_than_need_be() {
    let mut library = Library::default();
    for (k, cm) in [21, 18, 15, 12].into_iter().enumerate() {
        let radius_m = 5e-3 * f64::from(cm);
        library
            .add(entry("hob-1", k as u64, |m| m.radius_m = radius_m))
            .unwrap();
    }
    let found = library.candidates(&window());
    assert_eq!(found[0].id, "hob-1-0");
    assert!(found.len() <= 3);
}

proptest! {
    #[test]
    fn any_bytes_are_an_entry_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = PotEntry::from_bytes(&bytes);
        let _ = Library::from_bytes(&bytes);
    }

    /// Bytes of an entry with some of them changed: what is taken has numbers that a fit can begin with.
    #[test]
    fn what_is_taken_can_be_used(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), prop::sample::select(b"0123456789.-e,]n\"".to_vec())), 1..4)
    ) {
        let mut bytes = entry("hob-1", 7, |_| ()).to_bytes();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(entry) = PotEntry::from_bytes(&bytes) {
            let prior = entry.prior();
            prop_assert!(prior.spread.is_sound());
            prop_assert!(crate::parameters::is_sound(&prior.from));
            let mut library = Library::default();
            library.add(entry.clone()).unwrap();
            library.add(super::tests::entry("hob-2", 8, |_| ())).unwrap();
            prop_assert!(library.entries().iter().all(|e| e.check().is_ok()));
            for candidate in library.candidates(&window()) {
                let beside = candidate.shape.at(40e3, 20.0);
                let variance = candidate.shape.variance(40e3, 20.0);
                prop_assert!(beside.iter().chain(&variance).all(|x| x.is_finite()));
            }
        }
    }
}
