//! Bases of known temperature over a glass, by the equations alone.

use std::vec::Vec;

use super::*;

impl PotHeat {
    fn base_c(&self) -> i32 {
        self.base / ONE_C
    }
}

/// The same in floating point.
#[derive(Default)]
struct Oracle {
    mean_c: Option<f64>,
}

impl Oracle {
    fn base_c(&mut self, glass_c: f64) -> f64 {
        let mean_c = self.mean_c.get_or_insert(glass_c);
        let above_c = glass_c - *mean_c;
        *mean_c += above_c / 5.0;
        *mean_c + 80.0 / 5.0 * above_c + 0.38 * (*mean_c - 25.0).max(0.0)
    }
}

/// Glass of 1 m² and its sensor, below a base with a conductance in W/m²K.
struct Glass {
    glass_c: f64,
    sensor_c: f64,
    h: f64,
}

impl Glass {
    fn cold(h: f64) -> Self {
        Self {
            glass_c: 25.0,
            sensor_c: 25.0,
            h,
        }
    }

    /// A hundred readings of a second with the base at one temperature.
    fn second(&mut self, base_c: f64, heat: &mut PotHeat) {
        for _ in 0..100 {
            let down = self.h * (base_c - self.glass_c) - 43.0 * (self.glass_c - 25.0);
            self.glass_c += down * 0.01 / 8.1e3;
            self.sensor_c += (self.glass_c - self.sensor_c) * 0.01 / 10.0;
            heat.take(Some((self.sensor_c * 16.0) as i32));
        }
        heat.count(1);
    }
}

/// Base's true temperature when less than all of the rating is left; it heats by so much a second up to a highest temperature.
fn slowed_at_c(h: f64, k_per_s: f64, highest_c: f64) -> Option<f64> {
    let (mut glass, mut heat) = (Glass::cold(h), PotHeat::default());
    (0..900).find_map(|s| {
        let base_c = (25.0 + k_per_s * f64::from(s)).min(highest_c);
        glass.second(base_c, &mut heat);
        (heat.power_w() < RATED_POWER_W).then_some(base_c)
    })
}

#[test]
fn an_empty_pan_is_slowed_before_300_degrees() {
    // 2.5 kW into 730 J/K, 1.25 kW into 267 J/K, 1 kW into 730 J/K.
    for k_per_s in [3.4, 4.7, 1.4] {
        for h in [115.0, 170.0, 230.0, 350.0] {
            let at_c = slowed_at_c(h, k_per_s, 400.0).unwrap();
            assert!((150.0..285.0).contains(&at_c), "{h} {k_per_s}: {at_c}");
        }
    }
}

#[test]
fn a_base_below_boiling_water_is_never_slowed() {
    // 110 kW/m² through 5 mm of steel, and bubbles: 131 °C; with water it heats by some 2 K/s at most.
    for h in [20.0, 115.0, 230.0, 350.0] {
        for k_per_s in [0.2, 1.0, 2.0] {
            assert_eq!(slowed_at_c(h, k_per_s, 131.0), None, "{h} {k_per_s}");
        }
    }
}

#[test]
fn a_base_at_rest_is_known_with_the_contact_that_is_assumed() {
    let (mut glass, mut heat) = (Glass::cold(115.0), PotHeat::default());
    (0..900).for_each(|_| glass.second(200.0, &mut heat));
    assert!((heat.base_c() - 200).abs() <= 3, "{}", heat.base_c());
}

#[test]
fn power_comes_back_slowly_and_never_falls_to_nothing() {
    let mut heat = PotHeat::default();
    let mut at = |celsius: i32| {
        heat.take(Some(celsius * 16));
        heat.count(1);
        heat.power_w()
    };
    assert_eq!(at(20), RATED_POWER_W);
    assert_eq!(at(200), LEVELS[0].power_w);
    let back: Vec<u16> = (0..120).map(|_| at(20)).collect();
    assert!(back.is_sorted() && back.windows(2).all(|pair| pair[1] - pair[0] <= 26));
    assert_eq!(back[119], RATED_POWER_W);
}

#[test]
fn without_a_sensor_nothing_is_taken() {
    let mut heat = PotHeat::default();
    (0..10).for_each(|_| {
        heat.take(None);
        heat.count(1);
    });
    assert_eq!(heat.power_w(), RATED_POWER_W);
}

#[test]
fn a_loose_wire_hides_no_rate() {
    let mut heat = PotHeat::default();
    // 1.5 K/s of the glass is a base 120 K above it.
    for s in 0..100 {
        heat.take((s % 3 == 0).then_some(16 * 25 + 24 * s));
        heat.count(1);
    }
    assert_eq!(heat.power_w(), LEVELS[0].power_w);
}

#[test]
fn it_is_its_oracle() {
    let (mut heat, mut oracle) = (PotHeat::default(), Oracle::default());
    for s in 0..600 {
        let glass_c = 25.0 + 200.0 * (1.0 - (-f64::from(s) / 90.0).exp());
        (0..100).for_each(|_| heat.take(Some((glass_c * 16.0) as i32)));
        heat.count(1);
        let expected_c = oracle.base_c(glass_c);
        // 1/16 °C times 80 s over 5 s, and a degree.
        assert!(
            (f64::from(heat.base_c()) - expected_c).abs() < 2.1,
            "{s} {expected_c}"
        );
    }
}

#[test]
fn no_reading_overflows() {
    let mut heat = PotHeat::default();
    for (n, glass) in (0..100).zip([-640, 5_120].into_iter().cycle()) {
        (0..2 * READINGS_MAX).for_each(|_| heat.take(Some(glass)));
        heat.count(if n % 3 == 0 { u32::MAX } else { 1 });
        assert!((LEVELS[0].power_w..=RATED_POWER_W).contains(&heat.power_w()));
    }
}
