//! The map of a pot on any curves.
//!
//! What must hold:
//! - whatever windows say, each cell's R and L are positive numbers, its deviations numbers of zero or more, its confidence
//!   from 0 to 1;
//! - the device reads a lookup that is built as the same lookup, and what it would refuse is refused here;
//! - what is kept over a restart gives the same cells;
//! - a pot that is the prior but for factors is followed to 1 % where it was seen.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use ihd_map::{Cells, CurrentCurve, MeasuredPoint, PotMap};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_train::lookup::BuiltLookup;
use reader::Reader;

/// Curves of one input: each is a fit.
const MAX_CURVES: u8 = 4;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    if reader.u8() % 4 == 0 {
        scaled_prior(&mut reader);
    } else {
        any(&mut reader);
    }
});

fn any(reader: &mut Reader<'_>) {
    let mut map = PotMap::default();
    let mut now_s = 0.0;
    for _ in 0..reader.u8() % MAX_CURVES {
        now_s = reader.between(0.0, 1e4);
        map.rebase(now_s);
        map.observe(curve(reader, now_s));
    }
    let Some(cells) = map.cells(now_s) else {
        return;
    };
    check(&cells);
    let kept = map.state();
    if let Some(restored) = PotMap::from_state(kept) {
        assert_eq!(restored.cells(now_s), Some(cells));
    }
}

/// A curve as windows give it: in range mostly, in any order, any numbers now and then.
fn curve(reader: &mut Reader<'_>, t_s: f64) -> CurrentCurve {
    let wild = reader.u8() == 0;
    let f_sw_hz = match wild {
        true => reader.any_f64(),
        false => reader.between(25e3, 90e3),
    };
    let number = |reader: &mut Reader<'_>, low, high| match wild && reader.u8().is_multiple_of(4) {
        true => reader.any_f64(),
        false => reader.between(low, high),
    };
    let points: Vec<MeasuredPoint> = (0..reader.u8() / 4)
        .map(|_| MeasuredPoint {
            i_a: number(reader, 0.0, 100.0),
            r_ohm: number(reader, 0.02, 15.9),
            l_h: number(reader, 2e-6, 63.9e-6),
            r_sigma_ohm: number(reader, 1e-4, 1.0),
            l_sigma_h: number(reader, 1e-9, 1e-5),
        })
        .collect();
    CurrentCurve::new(f_sw_hz, t_s, points.into_iter())
}

fn check(cells: &Cells) {
    for cell in cells.iter().flatten() {
        let value = cell.value;
        let positive = |x: f64| x.is_finite() && x > 0.0;
        assert!(positive(value.r_ohm) && positive(value.l_h), "{cell:?}");
        assert!(value.r_sigma >= 0.0 && value.l_sigma >= 0.0, "{cell:?}");
        assert!((0.0..=1.0).contains(&cell.confidence), "{cell:?}");
    }
    if let Ok(built) = BuiltLookup::from_cells(*cells, 1) {
        let read = RlLookup::from_bytes(&built.lookup.to_bytes());
        assert_eq!(read.as_ref(), Ok(&built.lookup));
    }
}

/// Curves of a load that is the prior's but for one factor of R and one of L.
fn scaled_prior(reader: &mut Reader<'_>) {
    let (r, l) = (reader.between(0.7, 1.4), reader.between(0.7, 1.4));
    let mut map = PotMap::default();
    let f_sw_hz = reader.between(34e3, 80e3).round();
    let to_a = reader.between(15.0, 75.0);
    let point = |k: u32| {
        let i_a = 1.0 + (to_a - 1.0) * f64::from(k) / 99.0;
        let (r0, l0) = prior().interpolate(f_sw_hz as u32, (i_a * 1e3) as u32);
        MeasuredPoint {
            i_a,
            r_ohm: r * r0.ohm(),
            l_h: l * l0.henry(),
            r_sigma_ohm: 1e-3,
            l_sigma_h: 1e-8,
        }
    };
    let points: Vec<MeasuredPoint> = (0..100).map(point).collect();
    map.observe(CurrentCurve::new(f_sw_hz, 0.0, points.iter().copied()));
    check(&map.cells(0.0).expect("a whole curve"));
    let currents: Vec<f64> = points.iter().map(|p| p.i_a).collect();
    for (p, found) in points.iter().zip(map.along(f_sw_hz, &currents, 0.0)) {
        if p.i_a > 3.0 {
            assert!(
                (found.r_ohm / p.r_ohm - 1.0).abs() < 1e-2,
                "{p:?} {found:?}"
            );
            assert!((found.l_h / p.l_h - 1.0).abs() < 1e-2, "{p:?} {found:?}");
        }
    }
}
