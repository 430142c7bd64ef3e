use super::*;
use ihd_field::{FieldModel, harmonic};

fn z(pot: SimulatedPot) -> (f64, f64) {
    pot.field_settings(0.0)
        .unwrap()
        .iter()
        .fold((0.0, 0.0), |(r, l), (w, s)| {
            let z = harmonic::impedance(&FieldModel::new(s).unwrap(), 45e3, 10.0).unwrap();
            (r + w * z.r_ohm, l + w * z.l_h)
        })
}

#[test]
fn names_round_trip_and_unknown_ones_are_refused() {
    for name in [
        "ferritic-18",
        "cast-iron-7",
        "stainless-5",
        "aluminium-12.5",
        "clad-16",
        "foil-18",
        "lid-20",
        "spoon-4",
        "ring-20",
        "ferritic-26",
        "none",
    ] {
        assert_eq!(name.parse::<SimulatedPot>().unwrap().to_string(), name);
    }
    for bad in ["copper-18", "ferritic-50", "ferritic-x", "", "ferritic-NaN"] {
        assert!(
            bad.parse::<SimulatedPot>()
                .unwrap_err()
                .to_string()
                .contains("ferritic-D"),
            "{bad}"
        );
    }
}

#[test]
fn old_names_are_understood() {
    assert_eq!(
        "ferromagnetic".parse(),
        Ok(SimulatedPot::new(PotBase::Ferritic, 0.21))
    );
    assert_eq!(
        "small".parse(),
        Ok(SimulatedPot::new(PotBase::Ferritic, 0.12))
    );
    assert_eq!(
        "cast-iron".parse(),
        Ok(SimulatedPot::new(PotBase::CastIron, 0.21))
    );
}

#[test]
fn the_least_and_the_most_that_can_be_put_on_has_a_load() {
    let bare = z(SimulatedPot {
        lift_m: 0.1,
        ..SimulatedPot::new(PotBase::Ferritic, 0.05)
    });
    let off = z(SimulatedPot {
        offset_m: 0.06,
        ..SimulatedPot::new(PotBase::CastIron, 0.12)
    });
    let wide = z(SimulatedPot::new(PotBase::CastIron, 0.26));
    println!("{bare:?} {off:?} {wide:?}");
    assert!(bare.0 < 0.05 && (4e-5..6e-5).contains(&bare.1), "{bare:?}");
    assert!((0.2..2.5).contains(&off.0) && off.1 > 3e-5, "{off:?}");
    assert!(wide.0 > 2.5 && wide.1 < 3.5e-5, "{wide:?}");
    let too_far = SimulatedPot {
        offset_m: 0.061,
        ..SimulatedPot::new(PotBase::CastIron, 0.12)
    };
    let refused = too_far.field_settings(0.0).unwrap_err().to_string();
    assert!(refused.contains("60 mm for 12 cm"), "{refused}");
}

#[test]
fn smaller_and_lifted_pots_couple_less() {
    let full = z(SimulatedPot::new(PotBase::Ferritic, 0.21));
    let small = z(SimulatedPot::new(PotBase::Ferritic, 0.12));
    let lifted = z(SimulatedPot {
        lift_m: 0.02,
        ..SimulatedPot::new(PotBase::Ferritic, 0.21)
    });
    assert!(
        // Finite elements at 10 A: 2.95 of 5.22 ohm (tests/field-oracle).
        (0.5..0.62).contains(&(small.0 / full.0)) && small.1 > full.1,
        "{small:?} {full:?}"
    );
    assert!(lifted.0 < 0.5 * full.0, "{lifted:?} {full:?}");
}

#[test]
fn off_centre_tends_to_centred() {
    let centred = z(SimulatedPot::new(PotBase::Ferritic, 0.18));
    let nearly = z(SimulatedPot {
        offset_m: 1e-3,
        ..SimulatedPot::new(PotBase::Ferritic, 0.18)
    });
    let far = z(SimulatedPot {
        offset_m: 0.05,
        ..SimulatedPot::new(PotBase::Ferritic, 0.18)
    });
    assert!(
        (nearly.0 / centred.0 - 1.0).abs() < 0.01,
        "{nearly:?} {centred:?}"
    );
    assert!(far.0 < centred.0);
}

#[test]
fn a_hot_pot_is_the_cold_one_at_a_lower_frequency() {
    let at = |pot: SimulatedPot, f_hz, i_a| {
        let mut settings = pot.field_settings(0.0).unwrap().remove(0).1;
        // The shield stays cold.
        settings.geometry.shield_thickness_m = 0.0;
        harmonic::impedance(&FieldModel::new(&settings).unwrap(), f_hz, i_a).unwrap()
    };
    for base in PotBase::ALL {
        for (temperature_c, i_a) in [(90.0, 3.0), (150.0, 30.0), (400.0, 60.0)] {
            let cold = SimulatedPot::new(base, 0.18);
            let hot = at(
                SimulatedPot {
                    temperature_c,
                    ..cold
                },
                45e3,
                i_a,
            );
            let factor = base.heat_factor(temperature_c);
            let like = at(cold, 45e3 / factor, i_a);
            let (r, l) = (factor * like.r_ohm / hot.r_ohm, like.l_h / hot.l_h);
            println!("{base:?} {temperature_c} °C {i_a} A: {factor} {r} {l}");
            // The grid into the depth is made for each material, a linear one's in all directions.
            let allowed = match base {
                PotBase::Ferritic | PotBase::CastIron | PotBase::Spoon => 1e-3,
                PotBase::Stainless
                | PotBase::Aluminium
                | PotBase::Foil
                | PotBase::Lid
                | PotBase::Ring => 1e-2,
                // Its base heats by another factor than its foil.
                PotBase::Clad => 2e-2,
            };
            assert!((r - 1.0).abs() < allowed && (l - 1.0).abs() < allowed);
        }
    }
}

#[test]
fn heat_raises_the_resistance_of_aluminium_as_the_root_of_its_resistivity() {
    let cold = z(SimulatedPot::new(PotBase::Aluminium, 0.21));
    let hot = z(SimulatedPot {
        temperature_c: 120.0,
        ..SimulatedPot::new(PotBase::Aluminium, 0.21)
    });
    assert!((hot.0 / cold.0 / 1.4f64.sqrt() - 1.0).abs() < 0.02);
}
