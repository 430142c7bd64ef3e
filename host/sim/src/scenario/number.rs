//! Numbers of a scenario file with their ranges: an error names the place of the number.

use serde::{Deserialize, Deserializer, de::Error};

fn within<'de, D: Deserializer<'de>>(
    from: D,
    (min, max): (f64, f64),
    allowed: &str,
) -> Result<f64, D::Error> {
    let value = f64::deserialize(from)?;
    if (min..=max).contains(&value) {
        return Ok(value);
    }
    Err(D::Error::custom(format!("{value}: must be {allowed}")))
}

/// Defines two functions for each: one for a required field, one for an optional field.
macro_rules! numbers {
    ($($name:ident $or_none:ident $min:literal $max:literal $allowed:literal;)+) => {$(
        pub(super) fn $name<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
            within(from, ($min, $max), $allowed)
        }

        #[allow(dead_code, reason = "not every number is both")]
        pub(super) fn $or_none<'de, D: Deserializer<'de>>(
            from: D,
        ) -> Result<Option<f64>, D::Error> {
            $name(from).map(Some)
        }
    )+};
}

numbers! {
    duration_s some_duration_s 1e-3 3600.0 "0.001 to 3600 s";
    time_s some_time_s 0.0 3600.0 "0 to 3600 s";
    v_rms some_v_rms 0.0 320.0 "0 to 320 V rms";
    hz some_hz 30.0 90.0 "30 to 90 Hz";
    lift_mm some_lift_mm 0.0 100.0 "0 to 100 mm";
    offset_mm some_offset_mm 0.0 110.0 "0 to 110 mm";
    temperature_c some_temperature_c -40.0 400.0 "-40 to 400 °C";
    power_w some_power_w 0.0 65535.0 "0 to 65535 W";
    r_ohm some_r_ohm 0.0 16.0 "0 to 16 ohm";
    l_uh some_l_uh 0.0 64.0 "0 to 64 µH";
    bus_uf some_bus_uf 0.0 1000.0 "0, or 0.1 to 1000 µF";
    line_uh some_line_uh 0.0 10000.0 "0, or 1 to 10000 µH";
    corner_hz some_corner_hz 0.0 1e7 "0 (none), or up to 10 MHz";
    noise_v some_noise_v 0.0 400.0 "0 to 400 V";
    noise_a some_noise_a 0.0 80.0 "0 to 80 A";
    contact some_contact 0.1 3.0 "0.1 to 3";
    permille some_permille 0.0 10.0 "0 to 10 permille";
    timer_min some_timer_min 0.0 255.0 "0 to 255 min";
    level some_level 0.0 9.0 "0 to 9";
    pass_min some_pass_min 0.0 600.0 "0 to 600 min";
    give_up_s some_give_up_s 60.0 600.0 "60 to 600 s";
}
