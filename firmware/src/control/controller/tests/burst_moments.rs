//! Mains, pot and requests that change at a moment of a burst: the hob heats afterwards, as long as power is requested.

use super::*;

/// Half-cycles of a burst's period.
const PERIOD: u32 = 100;

type Moment = fn(&Bench) -> bool;
type Event = fn(&mut Bench);

/// Moments of a bench that gives bursts.
const MOMENTS: [(&str, Moment); 3] = [
    ("first", |bench| bench.drive.is_switching()),
    ("last", |bench| bench.off_at_crossing),
    ("probe", |bench| bench.probe_requested.is_some()),
];

/// Events, each undone within some half-cycles.
const EVENTS: [(&str, Event); 7] = [
    ("dip", |bench| bench.drive = Drive::OFF),
    ("pot lifted", |bench| {
        bench.load = AIR;
        bench.run(3);
        bench.load = POT;
    }),
    ("sheet", |bench| {
        bench.load = ALUMINIUM;
        bench.run(2 * PERIOD);
        bench.load = POT;
    }),
    ("mains lost", |bench| bench.trip(Fault::MAINS_LOST)),
    ("off and on", |bench| {
        bench.ask(0);
        bench.ask(200);
    }),
    ("more and less", |bench| {
        bench.ask(1_500);
        bench.run(1);
        bench.ask(200);
    }),
    ("host lost", |bench| {
        let action = bench.control.host_lost();
        bench.act(action);
        bench.run(1);
        bench.ask(200);
    }),
];

#[test]
fn whatever_happens_in_a_burst_others_follow() {
    for (moment, is_now) in MOMENTS {
        for (event, happen) in EVENTS {
            let mut bench = Bench::new(POT);
            bench.ask(200);
            bench.run(3 * PERIOD);
            while bench.drive.is_switching() {
                bench.run(1);
            }
            bench.run(PERIOD / 8);
            let probes = bench.probes;
            while !is_now(&bench) {
                bench.run(1);
                assert!(bench.probes < probes + 4, "{moment}: not seen");
            }
            happen(&mut bench);
            bench.run(5 * PERIOD);
            let (mut with_power, what) = (0, std::format!("{event} at {moment}"));
            for _ in 0..3 * PERIOD {
                bench.run(1);
                with_power += u32::from(bench.drive.is_switching());
            }
            // 200 W of the bench's 400: the half.
            assert!(
                with_power.abs_diff(3 * PERIOD / 2) < PERIOD / 5,
                "{what}: {with_power}"
            );
            assert_eq!(bench.control.state(), State::Heating, "{what}");
        }
    }
}
