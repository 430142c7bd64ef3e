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
const RUN_S: u32 = 900;
const STEP_S: f64 = 1.0 / STEPS_PER_S as f64;
const STEPS_PER_S: u32 = 10;

/// Length of a run that keeps warm, and of its end that counts, in seconds: two litres cool by 10 K an hour.
const WARM_S: (u32, u32) = (4 * 3_600, 1_800);

/// Highest temperatures of a run, and the first loss of power.
struct Shown {
    base_c: f64,
    contents_c: f64,
    /// Temperature of the base at which power was taken first, in °C.
    slowed_at_c: Option<f64>,
}

/// A pot on a glass, with the firmware's view of it.
struct Hob {
    thermal: ThermalModel,
    lumps: LumpTemperatures,
    sensors: Temperatures,
    heat: PotHeat,
    steps: u32,
}

impl Hob {
    fn new(pot: &SimulatedPot, contents: PotContents, contact: f64, glass_c: f64) -> Self {
        let mut lumps = LumpTemperatures::at(AMBIENT_C);
        lumps.set_glass(glass_c);
        let mut thermal = ThermalModel::new(contents, pot).with_contact(contact);
        thermal.set_room(AMBIENT_C);
        Self {
            thermal,
            lumps,
            sensors: Temperatures::default(),
            heat: PotHeat::default(),
            steps: 0,
        }
    }

    /// Advances by a step at a power in watt, and reads the sensors.
    fn advance(&mut self, power_w: f64) {
        let below = Heat {
            glass_j: self.thermal.advance_on(power_w, STEP_S, self.lumps.glass_c),
            ..Heat::default()
        };
        self.lumps.advance(STEP_S, &below, true);
        self.sensors
            .update(self.lumps.codes(&Injections::default()));
        self.heat.take(self.sensors.glass());
        self.steps += 1;
        if self.steps.is_multiple_of(STEPS_PER_S) {
            self.heat.pass_time(1_000);
        }
    }
}

/// Cooks at one power, less what the firmware takes away: for its sensors alone, or for the pot as well.
fn cook(
    pot: &SimulatedPot,
    contents: PotContents,
    contact: f64,
    setting: (f64, f64, bool),
) -> Shown {
    let (asked_w, glass_c, limited) = setting;
    let mut hob = Hob::new(pot, contents, contact, glass_c);
    let mut shown = Shown {
        base_c: 0.0,
        contents_c: 0.0,
        slowed_at_c: None,
    };
    for _ in 0..RUN_S * STEPS_PER_S {
        let sensors_w = f64::from(RATED_POWER_W) * f64::from(hob.sensors.power_percent()) / 100.0;
        let pot_w = if limited {
            f64::from(hob.heat.power_w())
        } else {
            asked_w
        };
        let power_w = asked_w.min(sensors_w).min(pot_w);
        if power_w < 0.98 * asked_w {
            shown.slowed_at_c.get_or_insert(hob.thermal.temperature_c());
        }
        hob.advance(power_w);
        shown.base_c = shown.base_c.max(hob.thermal.temperature_c());
        shown.contents_c = shown.contents_c.max(hob.thermal.bulk_c().unwrap_or(0.0));
        // Water that has boiled away leaves an empty pot, which has rows of its own.
        if matches!(contents, PotContents::Water(_)) && hob.thermal.bulk_c().is_none() {
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
    fn summarise(kind: &Kind, runs: &[Shown]) -> Self {
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

/// The rule's limits for one kind of contents at one contact.
fn assert_within_limits(kind: &Kind, contact: f64, with: &Sums) {
    if contact >= 0.5 && kind.name == "empty" {
        assert!(with.hottest_c.0 < 310.0, "empty at contact {contact}");
    } else if contact >= 0.5 {
        assert_eq!(with.overheated, 0, "{} at contact {contact}", kind.name);
    }
    // A boiling pot from another zone on cold glass looks hotter than it is, the better its contact.
    if kind.name.starts_with("water") && contact <= 1.0 {
        assert_eq!(with.slowed, 0, "water at contact {contact}");
    }
}

/// The least contact for which the rule promises it; and the best for which water is not slowed.
#[test]
fn no_pot_becomes_too_hot() {
    for kind in &KINDS {
        for contact in [0.5, 1.0] {
            let with = Sums::summarise(kind, &runs(kind, contact, true));
            assert_within_limits(kind, contact, &with);
        }
    }
}

#[test]
fn the_document_says_how_hot_pots_become_all_variants() {
    let mut table = String::from(
        "| contents | contact | runs | hottest base, contents, °C | overheated | slowed | from a base of, °C | without the rule: hottest, °C | overheated |\n\
         |---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for kind in &KINDS {
        for contact in [0.25, 0.5, 0.75, 1.0, 1.5] {
            let [with, without] =
                [true, false].map(|limited| Sums::summarise(kind, &runs(kind, contact, limited)));
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
            assert_within_limits(kind, contact, &with);
        }
    }
    let command = "cargo test -p ihd-tests hot_pots";
    document::hold("control.md", "hot pots", &table, command);
}

/// Lowest and highest temperature of water that is kept warm, at the end of a run, in °C, and the power then, in watt.
fn keep_warm(pot: &SimulatedPot, litre: f64, contact: f64, glass_c: f64) -> [(f64, f64); 2] {
    let mut hob = Hob::new(pot, PotContents::Water(litre), contact, glass_c);
    let none = (f64::INFINITY, 0.0);
    let widened = |(low, high): (f64, f64), x: f64| (low.min(x), high.max(x));
    let (mut water_c, mut given_w) = (none, none);
    for s in 0..WARM_S.0 {
        let power_w = f64::from(hob.heat.warm_w());
        (0..STEPS_PER_S).for_each(|_| hob.advance(power_w));
        if s >= WARM_S.0 - WARM_S.1 {
            water_c = widened(water_c, hob.thermal.bulk_c().expect("water"));
            given_w = widened(given_w, power_w);
        }
    }
    [water_c, given_w]
}

#[test]
fn the_document_says_how_warm_pots_are_kept_at_length() {
    let mut table =
        String::from("| contact | runs | water, °C | power, W |\n|---:|---:|---:|---:|\n");
    for contact in [0.25, 0.5, 0.75, 1.0, 1.5] {
        let mut all = Vec::new();
        for (pot_c, glass_c) in [(20.0, 25.0), (95.0, 80.0), (60.0, 150.0)] {
            for (metal, diameter_m, _) in POTS {
                let pot = SimulatedPot {
                    temperature_c: pot_c,
                    ..SimulatedPot::new(metal, diameter_m)
                };
                all.extend([0.5, 2.0].map(|litre| keep_warm(&pot, litre, contact, glass_c)));
            }
        }
        let [water_c, given_w] = [0, 1].map(|what| {
            let ranges = all.iter().map(|run| run[what]);
            ranges.fold((f64::INFINITY, 0.0_f64), |(low, high), run| {
                (low.min(run.0), high.max(run.1))
            })
        });
        // A `String` takes every line.
        let _ = writeln!(
            table,
            "| {contact} | {} | {:.0} to {:.0} | {:.0} to {:.0} |",
            all.len(),
            water_c.0,
            water_c.1,
            given_w.0,
            given_w.1
        );
        assert!(given_w.0 > 0.0, "contact {contact}: still cooling");
        if contact >= 0.5 {
            // In whole degrees, as the document has it.
            let within = water_c.0.round() >= 65.0 && water_c.1.round() <= 76.0;
            assert!(within, "contact {contact}: {water_c:?} °C");
        }
    }
    let command = "cargo test -p ihd-tests hot_pots";
    document::hold("control.md", "warm pots", &table, command);
}
