//! Limit of what stands on the glass, over pots, contacts, contents and starts: how hot it becomes with the firmware's rule and without
//! it, and how often it takes power from water.

use std::fmt::Write;

use ihd_firmware::control::pot_heat::PotHeat;
use ihd_firmware::control::temperature::Temperatures;
use ihd_shared::hob::RATED_POWER_W;
use ihd_sim::contents::PotContents;
use ihd_sim::injection::Injections;
use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::temperatures::{AMBIENT_C, Heat, LumpTemperatures};
use ihd_sim::thermal_model::ThermalModel;

use super::document;

/// Base, its diameter in metre, and the most that the firmware gives it, in watt.
const POTS: [(PotBase, f64, f64); 6] = [
    (PotBase::Ferritic, 0.12, 1_250.0),
    (PotBase::Ferritic, 0.15, 2_500.0),
    (PotBase::Ferritic, 0.18, 2_500.0),
    (PotBase::Ferritic, 0.21, 2_500.0),
    (PotBase::Ferritic, 0.26, 2_500.0),
    (PotBase::CastIron, 0.21, 2_500.0),
];

/// Temperatures of pot and glass at the start in °C: cold; the glass of the pot before; a pot from another zone; both.
const STARTS: [(f64, f64); 4] = [(20.0, 25.0), (20.0, 150.0), (95.0, 25.0), (95.0, 150.0)];

/// Powers asked, in watt.
const POWERS: [f64; 3] = [2_500.0, 1_400.0, 700.0];

/// Length of a run and its step, in seconds.
const RUN_S: (f64, f64) = (900.0, 0.1);

/// Highest temperatures of a run, and the first loss of power.
struct Shown {
    base_c: f64,
    contents_c: f64,
    /// Temperature of the base at which power was taken first, in °C.
    slowed_at_c: Option<f64>,
}

/// Cooks at one power, less what the firmware takes away: for its sensors alone, or for the pot as well.
fn cook(
    pot: &SimulatedPot,
    contents: PotContents,
    contact: f64,
    setting: (f64, f64, bool),
) -> Shown {
    let (asked_w, glass_c, limited) = setting;
    let mut thermal = ThermalModel::new(contents, pot).with_contact(contact);
    let mut lumps = LumpTemperatures {
        contact,
        ..LumpTemperatures::at(AMBIENT_C)
    };
    lumps.set_glass(glass_c);
    let (mut sensors, mut heat) = (Temperatures::default(), PotHeat::default());
    let mut shown = Shown {
        base_c: 0.0,
        contents_c: 0.0,
        slowed_at_c: None,
    };
    let (run_s, step_s) = RUN_S;
    for step in 0..(run_s / step_s) as u32 {
        sensors.update(lumps.codes(&Injections::default()));
        heat.take(sensors.glass());
        if step % 10 == 9 {
            heat.count(1);
        }
        let sensors_w = f64::from(RATED_POWER_W) * f64::from(sensors.power_percent()) / 100.0;
        let pot_w = if limited {
            f64::from(heat.power_w())
        } else {
            asked_w
        };
        let power_w = asked_w.min(sensors_w).min(pot_w);
        if power_w < 0.98 * asked_w {
            shown.slowed_at_c.get_or_insert(thermal.temperature_c());
        }
        thermal.advance(power_w, step_s);
        let below = Heat {
            pot_c: Some(thermal.temperature_c()),
            ..Heat::default()
        };
        lumps.advance(step_s, &below, true);
        shown.base_c = shown.base_c.max(thermal.temperature_c());
        shown.contents_c = shown.contents_c.max(thermal.bulk_c().unwrap_or(0.0));
        // Water that has boiled away leaves an empty pot, which has rows of its own.
        if matches!(contents, PotContents::Water(_)) && thermal.bulk_c().is_none() {
            break;
        }
    }
    shown
}

/// A kind of contents, with the temperature that is too hot for base and contents, in °C.
struct Kind {
    name: &'static str,
    contents: &'static [PotContents],
    too_hot_c: (f64, f64),
}

const KINDS: [Kind; 3] = [
    Kind {
        name: "empty",
        contents: &[PotContents::Empty],
        too_hot_c: (300.0, f64::INFINITY),
    },
    Kind {
        name: "oil, 0.3 and 1 l",
        contents: &[PotContents::Oil(0.3), PotContents::Oil(1.0)],
        too_hot_c: (300.0, 230.0),
    },
    Kind {
        name: "water, 0.5 and 2 l",
        contents: &[PotContents::Water(0.5), PotContents::Water(2.0)],
        too_hot_c: (300.0, f64::INFINITY),
    },
];

/// Runs of a kind with one contact, with the rule or without.
fn runs(kind: &Kind, contact: f64, limited: bool) -> Vec<Shown> {
    let mut all = Vec::new();
    for &contents in kind.contents {
        for (metal, diameter_m, most_w) in POTS {
            for (pot_c, glass_c) in STARTS {
                for asked_w in POWERS.map(|w| w.min(most_w)) {
                    let pot = SimulatedPot {
                        temperature_c: pot_c,
                        ..SimulatedPot::new(metal, diameter_m)
                    };
                    all.push(cook(&pot, contents, contact, (asked_w, glass_c, limited)));
                }
            }
        }
    }
    all
}

/// Sums of runs.
struct Sums {
    runs: usize,
    hottest_c: (f64, f64),
    overheated: usize,
    slowed: usize,
    slowed_from_c: f64,
}

impl Sums {
    fn of(kind: &Kind, runs: &[Shown]) -> Self {
        let too_hot =
            |run: &&Shown| run.base_c > kind.too_hot_c.0 || run.contents_c > kind.too_hot_c.1;
        let most = |of: fn(&Shown) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let slowed = runs.iter().filter_map(|run| run.slowed_at_c);
        Self {
            runs: runs.len(),
            hottest_c: (most(|run| run.base_c), most(|run| run.contents_c)),
            overheated: runs.iter().filter(too_hot).count(),
            slowed: slowed.clone().count(),
            slowed_from_c: slowed.fold(f64::INFINITY, f64::min),
        }
    }
}

#[test]
fn the_document_says_how_hot_pots_become() {
    let mut table = String::from(
        "| contents | contact | runs | hottest base, contents, °C | overheated | slowed | from a base of, °C | without the rule: hottest, °C | overheated |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for kind in &KINDS {
        for contact in [0.25, 0.5, 0.75, 1.0, 1.5] {
            let [with, without] =
                [true, false].map(|limited| Sums::of(kind, &runs(kind, contact, limited)));
            let hottest = |sums: &Sums| match sums.hottest_c {
                (base_c, 0.0) => format!("{base_c:.0}"),
                (base_c, contents_c) => format!("{base_c:.0}, {contents_c:.0}"),
            };
            let from_c = match with.slowed {
                0 => String::new(),
                _ => format!("{:.0}", with.slowed_from_c),
            };
            // A `String` takes every line.
            let _ = writeln!(
                table,
                "| {} | {contact} | {} | {} | {} | {} | {from_c} | {} | {} |",
                kind.name,
                with.runs,
                hottest(&with),
                with.overheated,
                with.slowed,
                hottest(&without),
                without.overheated
            );
            if contact >= 0.5 {
                assert_eq!(with.overheated, 0, "{} at contact {contact}", kind.name);
            }
            // A boiling pot from another zone on cold glass looks hotter than it is, the better its contact.
            if kind.name.starts_with("water") && contact <= 1.0 {
                assert_eq!(with.slowed, 0, "water at contact {contact}");
            }
        }
    }
    let command = "cargo test -p ihd-tests hot_pots";
    document::hold("control.md", "hot pots", &table, command);
}
