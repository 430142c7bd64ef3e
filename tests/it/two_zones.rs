//! Two hobs on one supply, with the wire between their controllers: power of each, what they draw together, and what a broken wire
//! and a controller that ends do.

use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::{Limit, State};
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::pot::SimulatedPot;

/// Half-cycles of a second.
const HALF_CYCLES_PER_S: usize = 100;

/// State of the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Whole,
    /// The first zone has the resistor.
    Broken,
    /// Shorted to ground.
    Low,
}

/// Two zones, with the powers of all half-cycles so far, in watt.
struct Zones {
    hobs: [SimHob; 2],
    wire: Wire,
    powers_w: [Vec<f64>; 2],
}

impl Zones {
    /// Zones with equal pots that were switched on in the same half-cycle.
    fn new(supply: SupplyParts) -> Self {
        let hob = |seed: u64| {
            SimHob::new(&HobConfig {
                seed,
                supply,
                ..HobConfig::default()
            })
        };
        Self {
            hobs: [hob(1), hob(2)],
            wire: Wire::Whole,
            powers_w: [Vec::new(), Vec::new()],
        }
    }

    fn of_schematic() -> Self {
        Self::new(SupplyParts::SCHEMATIC)
    }

    /// Sets the panels' levels after half a second, when both know of the wire.
    fn switched_on(mut self, levels: [u8; 2]) -> Self {
        self.run(0.5);
        self.set(levels);
        self
    }

    fn set(&mut self, levels: [u8; 2]) {
        for (hob, level) in self.hobs.iter_mut().zip(levels) {
            hob.panel(PanelEvent::Level(level));
        }
    }

    /// Lets time pass, the hob whose clock is behind first.
    fn run(&mut self, duration_s: f64) {
        let end_s = self.hobs[0].t_s() + duration_s;
        loop {
            let [first_s, second_s] = [0, 1].map(|zone: usize| self.hobs[zone].t_s());
            if first_s.min(second_s) >= end_s {
                return;
            }
            let zone = usize::from(second_s < first_s);
            let others = self.hobs[1 - zone].pulls_share_wire();
            let hob = &mut self.hobs[zone];
            hob.set_share_wire(match self.wire {
                Wire::Whole => Some(others),
                Wire::Broken if zone == 0 => Some(false),
                Wire::Broken => None,
                Wire::Low => Some(true),
            });
            hob.step();
            if let Some(reading) = hob.take_reading() {
                self.powers_w[zone].push(reading.power_w());
            }
        }
    }

    /// Powers of the last seconds.
    fn last(&self, seconds: usize) -> [&[f64]; 2] {
        [0, 1].map(|zone: usize| {
            let all = &self.powers_w[zone];
            &all[all.len() - seconds * HALF_CYCLES_PER_S..]
        })
    }

    fn means_w(&self, seconds: usize) -> [f64; 2] {
        self.last(seconds)
            .map(|powers| powers.iter().sum::<f64>() / powers.len() as f64)
    }

    /// Half-cycles of the last seconds in which both zones drew power, and those in which none did.
    fn both_and_none(&self, seconds: usize) -> (usize, usize) {
        let [first, second] = self.last(seconds);
        // A pot probe takes up to 140 W of its half-cycle, a burst 720 at least.
        let draws = first
            .iter()
            .zip(second)
            .map(|(a, b)| (*a > 250.0, *b > 250.0));
        let (mut both, mut none) = (0, 0);
        for drawing in draws {
            both += usize::from(drawing == (true, true));
            none += usize::from(drawing == (false, false));
        }
        (both, none)
    }

    /// Mean and standard deviation of the supply's power over the last seconds, in watt.
    fn supply_w(&self, seconds: usize) -> (f64, f64) {
        let [first, second] = self.last(seconds);
        let all: Vec<f64> = first.iter().zip(second).map(|(a, b)| a + b).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let square = all.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / all.len() as f64;
        (mean, square.sqrt())
    }

    fn limits(&self) -> [Limit; 2] {
        [0, 1].map(|zone: usize| self.hobs[zone].housekeeping().control().limit())
    }
}

/// 1,000 and 700 W: one burst follows the other, each zone has its power, and the supply's hardly changes.
#[test]
fn two_zones_take_turns() {
    let mut zones = Zones::of_schematic().switched_on([6, 5]);
    zones.run(15.0);
    let [first_w, second_w] = zones.means_w(4);
    assert!((first_w / 1_000.0 - 1.0).abs() < 0.05, "{first_w} W");
    assert!((second_w / 700.0 - 1.0).abs() < 0.05, "{second_w} W");
    let (both, none) = zones.both_and_none(4);
    assert_eq!(both, 0, "half-cycles of both");
    assert!(none < 20, "{none} of 400 half-cycles without power");
    let (mean_w, deviation_w) = zones.supply_w(4);
    println!(
        "{first_w:.0} and {second_w:.0} W, {none} of 400 half-cycles without; supply {mean_w:.0} ± {deviation_w:.0} W"
    );
    assert!(deviation_w < 0.25 * mean_w, "{mean_w} ± {deviation_w} W");
    assert_eq!(zones.limits(), [Limit::None; 2]);
}

/// 2,500 and 1,900 W of a supply that has one zone's rating.
#[test]
fn more_than_the_supply_has_is_shared_and_told() {
    let mut zones = Zones::of_schematic().switched_on([9, 8]);
    zones.run(10.0);
    let (mean_w, deviation_w) = zones.supply_w(6);
    println!(
        "{:.0?} W; supply {mean_w:.0} ± {deviation_w:.0} W",
        zones.means_w(6)
    );
    let rated_w = f64::from(RATED_POWER_W);
    assert!((0.95..1.03).contains(&(mean_w / rated_w)), "{mean_w} W");
    let most_w = zones.last(6).concat().into_iter().fold(0.0, f64::max);
    assert!(most_w < 1.05 * rated_w, "{most_w} W");
    assert_eq!(zones.both_and_none(6).0, 0, "half-cycles of both");
    assert!(zones.means_w(6).iter().all(|w| *w > 900.0));
    zones.run(1.0);
    for _ in 0..100 {
        zones.run(0.02);
        assert_eq!(zones.limits(), [Limit::SharedSupply; 2]);
    }
}

/// One zone heats without a break while the other is off, and gives way to it within three seconds.
#[test]
fn a_zone_alone_has_the_supply_until_the_other_is_switched_on() {
    let mut zones = Zones::of_schematic().switched_on([6, 0]);
    zones.run(2.0);
    let alone = zones.last(1)[0];
    assert!(
        alone.iter().all(|w| (w / 1_000.0 - 1.0).abs() < 0.03),
        "{alone:?}"
    );
    zones.set([6, 3]);
    zones.run(4.0);
    assert_eq!(zones.both_and_none(4).0, 0, "half-cycles of both");
    assert!(zones.means_w(1)[1] > 250.0);
    // It leaves: its pot is taken away in the middle of a turn.
    zones.hobs[1].set_pot(SimulatedPot::NONE).unwrap();
    zones.run(5.5);
    let [first_w, second_w] = zones.means_w(1);
    assert!((first_w / 1_000.0 - 1.0).abs() < 0.03, "{first_w} W");
    assert!(second_w < 5.0, "{second_w} W");
}

/// A link that the other zone discharges lets a bridge begin within a half-cycle, not after 25 ms: the handover is the same.
#[test]
fn turns_do_not_overlap_without_a_capacitor_at_the_link() {
    let mut zones = Zones::new(SupplyParts::NONE).switched_on([6, 5]);
    // By then the lengths of the turns have settled.
    zones.run(11.0);
    let (both, none) = zones.both_and_none(3);
    assert_eq!(both, 0, "half-cycles of both");
    // Seven handovers of up to two half-cycles.
    assert!(none < 15, "{none} of 300 half-cycles without power");
}

/// A watchdog's reset, or one over the link: the other zone heats on, and this one waits for the wire before it heats again.
#[test]
fn a_zone_that_is_reset_does_not_heat_beside_the_other() {
    let mut zones = Zones::of_schematic().switched_on([6, 0]);
    zones.run(2.0);
    zones.hobs[1].restart();
    zones.run(0.013);
    zones.set([6, 5]);
    zones.run(5.0);
    assert_eq!(zones.both_and_none(5).0, 0, "half-cycles of both");
    let [first_w, second_w] = zones.means_w(4);
    assert!(
        first_w > 700.0 && second_w > 500.0,
        "{first_w} and {second_w} W"
    );
}

/// The wire is free between two bursts of the other zone, so that a zone has it before the pause after its probe is over.
#[test]
fn a_zone_that_starts_between_bursts_of_the_other_heats_at_once() {
    let mut zones = Zones::of_schematic().switched_on([1, 0]);
    zones.run(3.3);
    let draws = |zones: &Zones| zones.last(1).map(|w| w.iter().any(|w| *w > 250.0));
    assert_eq!(draws(&zones), [true, false]);
    zones.set([1, 1]);
    zones.run(1.3);
    assert_eq!(draws(&zones), [true, true]);
}

/// A wire that fails never lets both heat at once.
#[test]
fn a_wire_that_fails_leaves_one_zone_or_none() {
    for (wire, expected_w) in [(Wire::Broken, 1_000.0), (Wire::Low, 0.0)] {
        let mut zones = Zones::of_schematic().switched_on([6, 5]);
        zones.run(2.0);
        zones.wire = wire;
        zones.run(5.0);
        assert_eq!(zones.both_and_none(5).0, 0, "{wire:?}: half-cycles of both");
        let [first_w, second_w] = zones.means_w(2);
        assert!((first_w - expected_w).abs() < 30.0, "{wire:?}: {first_w} W");
        // It looks at its pot while it waits.
        assert!(second_w < 5.0, "{wire:?}: {second_w} W");
        let state = zones.hobs[1].housekeeping().control().state();
        assert_eq!(state, State::Heating, "{wire:?}: it waits for its turn");
        assert_eq!(zones.limits()[1], Limit::SharedSupply, "{wire:?}");
    }
}
