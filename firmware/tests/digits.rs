//! Digits that firmware/on-target expects of the controller, computed on this machine.

#[path = "../on-target/src/digits.rs"]
mod digits;

use ihd_firmware::sampling::path::SamplingPath;
use ihd_shared::units::{MicroOhm, PicoHenry};

#[test]
fn the_digits_that_the_controller_must_give() {
    let mut path = Box::new(SamplingPath::new(
        MicroOhm(4_000_000),
        PicoHenry(25_000_000),
    ));
    let digits = digits::run(&mut path);
    assert_eq!(digits.crc, digits::EXPECTED, "{digits:x?}");
}

/// 768 codes of ±640 V over 512 of ±80 A are 12 Ω; they lag by 200 to 231 of 1024 steps, 70 to 81°, at 70 kHz.
#[test]
fn the_digits_are_those_of_the_samples() {
    let mut path = Box::new(SamplingPath::new(
        MicroOhm(4_000_000),
        PicoHenry(25_000_000),
    ));
    let digits = digits::run(&mut path);
    assert!(digits.estimates > digits::BLOCKS * 9 / 10, "{digits:?}");
    let (r_ohm, l_uh) = (
        f64::from(digits.last.r.0) * 1e-6,
        f64::from(digits.last.l.0) * 1e-6,
    );
    assert!((1.5..4.5).contains(&r_ohm), "{r_ohm} Ω");
    assert!((25.0..27.8).contains(&l_uh), "{l_uh} µH");
}
