//! The lookup builder on any curves and weights.
//!
//! What must hold of a lookup that is built:
//! - a cell that is not marked as observed equals the prior bit for bit; marked is what has the confidence;
//! - confidences are numbers from 0 to 1;
//! - the device reads its bytes as the same lookup if it is plausible, and refuses them if not: the trainer
//!   checks that before it pushes, as here;
//! - the prior's own curves, by one factor, give a lookup that is plausible and follows them to 1 %.

#![no_main]

mod reader;

use ihd_shared::lookup::blob::BlobError;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES};
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{RlLookup, plausible};
use ihd_train::lookup::builder::OBSERVED_FROM;
use ihd_train::lookup::curve::LoadPoint;
use ihd_train::lookup::{Built, LoadCurve, LookupBuilder};
use reader::Reader;

/// Curves of one input.
const MOST_CURVES: u8 = 16;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    if reader.u8() % 4 == 0 {
        scaled_prior(&mut reader);
    } else {
        any(&mut reader);
    }
});

fn any(reader: &mut Reader<'_>) {
    let mut builder = LookupBuilder::new(prior());
    for _ in 0..reader.u8() % MOST_CURVES {
        let curve = curve(reader);
        let weight = match reader.u8() {
            0 => reader.any_f64().abs(),
            steps => f64::from(steps) / 64.0,
        };
        if weight.is_finite() {
            builder.observe(&curve, weight);
        }
    }
    if let Some(built) = builder.build(reader.u32()) {
        check(&built);
    }
}

/// A curve as windows give it: in range mostly, in any order, any numbers now and then.
fn curve(reader: &mut Reader<'_>) -> LoadCurve {
    let wild = reader.u8() == 0;
    let f_sw_hz = match wild {
        true => reader.any_f64(),
        false => reader.between(25e3, 90e3),
    };
    let number = |reader: &mut Reader<'_>, low, high| match wild && reader.u8() % 4 == 0 {
        true => reader.any_f64(),
        false => reader.between(low, high),
    };
    let points: Vec<LoadPoint> = (0..reader.u8())
        .map(|_| LoadPoint {
            i_a: number(reader, 0.0, 100.0),
            r_ohm: number(reader, 0.02, 15.9),
            l_h: number(reader, 2e-6, 63.9e-6),
        })
        .collect();
    LoadCurve::from_half_cycle(f_sw_hz, points.into_iter())
}

fn check(built: &Built) {
    let (lookup, prior) = (&built.lookup, prior());
    for f in 0..FREQUENCIES {
        for i in 0..CURRENTS {
            let confidence = built.confidence[f][i];
            assert!((0.0..=1.0).contains(&confidence), "{confidence}");
            let observed = lookup.is_observed(f, i);
            assert_eq!(observed, confidence >= OBSERVED_FROM);
            if !observed {
                assert_eq!(lookup.r[f][i], prior.r[f][i], "R, cell {f},{i}");
                assert_eq!(lookup.l[f][i], prior.l[f][i], "L, cell {f},{i}");
            }
        }
    }
    let read = RlLookup::from_bytes(&lookup.to_bytes());
    match plausible::check(lookup) {
        Ok(()) => assert_eq!(read.as_ref(), Ok(lookup)),
        Err(why) => assert_eq!(read, Err(BlobError::Implausible(why))),
    }
}

/// Curves of a load that is the prior's but for one factor of R and one of L.
fn scaled_prior(reader: &mut Reader<'_>) {
    let (r, l) = (reader.between(0.7, 1.4), reader.between(0.7, 1.4));
    let mut builder = LookupBuilder::new(prior());
    let mut seen = Vec::new();
    for _ in 0..reader.u8() % MOST_CURVES {
        let f_sw_hz = reader.between(34e3, 80e3).round();
        // A half-cycle begins and ends without current.
        let (from_a, to_a) = (1.0, reader.between(5.0, 75.0));
        let points: Vec<LoadPoint> = (0..100)
            .map(|k| {
                let i_a = from_a + (to_a - from_a) * f64::from(k) / 99.0;
                let (r0, l0) = prior().interpolate(f_sw_hz as u32, (i_a * 1e3) as u32);
                LoadPoint {
                    i_a,
                    r_ohm: r * r0.ohm(),
                    l_h: l * l0.henry(),
                }
            })
            .collect();
        let curve = LoadCurve::from_half_cycle(f_sw_hz, points.iter().copied());
        builder.observe(&curve, 1.0 + reader.between(0.0, 1.0));
        seen.push((f_sw_hz as u32, points));
    }
    let built = builder.build(1).expect("well conditioned");
    check(&built);
    assert_eq!(plausible::check(&built.lookup), Ok(()));
    for (f_sw_hz, points) in seen {
        for p in points
            .iter()
            .filter(|p| all_observed(&built.lookup, f_sw_hz, p.i_a))
        {
            let (r, l) = built.lookup.interpolate(f_sw_hz, (p.i_a * 1e3) as u32);
            assert!(
                (r.ohm() / p.r_ohm - 1.0).abs() < 1e-2,
                "R {} {p:?}",
                r.ohm()
            );
            assert!(
                (l.henry() / p.l_h - 1.0).abs() < 1e-2,
                "L {} {p:?}",
                l.henry()
            );
        }
    }
}

/// Whether all four cells around a point rest on observations.
fn all_observed(lookup: &RlLookup, f_sw_hz: u32, i_a: f64) -> bool {
    use ihd_shared::lookup::grid::{current_coordinate, frequency_coordinate, split};
    let (f, _) = split(frequency_coordinate(f_sw_hz), FREQUENCIES);
    let (i, _) = split(current_coordinate((i_a * 1e3) as u32), CURRENTS);
    let corners = [(f, i), (f, i + 1), (f + 1, i), (f + 1, i + 1)];
    corners.iter().all(|&(f, i)| lookup.is_observed(f, i))
}
