//! Values that must lie below one another, in the same unit after a factor.

/// `lower` must lie below `upper`.
pub(crate) struct Order {
    /// Section and key of the smaller value.
    pub lower: &'static str,
    /// Section and key of the larger value.
    pub upper: &'static str,
    /// Factor on the smaller value.
    pub factor: f64,
    /// Reason.
    pub why: &'static str,
}

const fn order(lower: &'static str, upper: &'static str, factor: f64, why: &'static str) -> Order {
    Order {
        lower,
        upper,
        factor,
        why,
    }
}

/// Every pair.
pub(crate) const ORDER: &[Order] = &[
    order(
        "rating.f_sw_min_hz",
        "rating.f_sw_max_hz",
        1.1,
        "the controller needs a range",
    ),
    order(
        "coil.coil_inner_um",
        "coil.coil_outer_um",
        1.0,
        "the coil needs a width",
    ),
    order(
        "limits.planned_current_ma",
        "limits.soft_current_ma",
        1.0,
        "a soft limit acts beyond what is planned",
    ),
    order(
        "limits.soft_current_ma",
        "limits.trip_current_ma",
        1.0,
        "a trip comes after the soft limit",
    ),
    order(
        "limits.trip_current_ma",
        "front_end.coil_current_full_scale_ma",
        1.02,
        "the converter must show the trip",
    ),
    order(
        "limits.planned_coil_voltage_dv",
        "limits.soft_coil_voltage_dv",
        1.0,
        "a soft limit acts beyond what is planned",
    ),
    order(
        "limits.soft_coil_voltage_dv",
        "front_end.coil_voltage_full_scale_mv",
        102.0,
        "the converter must show the soft limit",
    ),
    order(
        "limits.bus_start_max_dv",
        "limits.bus_trip_dv",
        1.0,
        "a start must not trip",
    ),
    order(
        "limits.bus_trip_dv",
        "front_end.bus_full_scale_dv",
        1.02,
        "the converter must show the trip",
    ),
    // Crest with 15 % more than nominal: √2 · 1.15 in decivolt and in millivolt.
    order(
        "mains.mains_voltage_v",
        "limits.bus_start_max_dv",
        16.26,
        "the crest of 15 % more than the nominal mains must start",
    ),
    order(
        "mains.mains_voltage_v",
        "front_end.mains_full_scale_mv",
        1_626.0,
        "the converter must show the crest",
    ),
    order(
        "supply.link_capacitance_nf",
        "supply.link_capacitance_max_nf",
        1.0,
        "C2 may be larger by its tolerance",
    ),
];
