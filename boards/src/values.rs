//! Every value of a board file: its constant, type, range and purpose.

/// Value of a board file.
pub(crate) struct Value {
    /// Section of the file.
    pub section: &'static str,
    /// Key in the section; in capitals it is the constant's name.
    pub key: &'static str,
    /// Type of the constant.
    pub kind: &'static str,
    /// Smallest and largest number.
    pub range: (i64, i64),
    /// Purpose, as the constant's documentation.
    pub doc: &'static str,
}

macro_rules! values {
    ($($section:ident { $($key:ident: $kind:ident $min:literal..=$max:literal, $doc:literal;)+ })+) => {
        /// Every value; a file has all of them and no other.
        pub(crate) const VALUES: &[Value] = &[$($(Value {
            section: stringify!($section),
            key: stringify!($key),
            kind: stringify!($kind),
            range: ($min, $max),
            doc: $doc,
        }),+),+];
    };
}

values! {
    mains {
        mains_voltage_v: u32 90..=265, "Nominal mains voltage, in volt rms.";
        mains_frequency_hz: u32 45..=65, "Nominal mains frequency, in hertz.";
        line_mohm: u32 10..=10_000, "Resistance of the house's line in the simulation, in milliohm.";
        line_uh: u32 0..=10_000, "Inductance of the house's line in the simulation, in microhenry; 0 for none.";
    }
    rating {
        rated_power_w: u16 100..=10_000, "Rated mean power over a mains half-cycle, in watt.";
        f_sw_min_hz: u32 20_000..=150_000, "Lowest switching frequency, in hertz.";
        f_sw_max_hz: u32 77_000..=84_000, "Highest switching frequency, in hertz: the probe frequency, by which pots and sheets are told apart.";
    }
    supply {
        terminal_capacitance_nf: u32 50..=10_000, "C1 between the mains terminals, in nanofarad.";
        choke_leakage_uh: u32 1..=10_000, "Leakage inductance of the common-mode choke L1, in microhenry.";
        rectifier_mv: u32 0..=5_000, "Voltage of the rectifier's two conducting diodes, in millivolt.";
        rectifier_mohm: u32 0..=10_000, "Resistance of fuse, choke and the two diodes, in milliohm.";
        link_capacitance_nf: u32 100..=1_000_000, "C2 of the DC link, in nanofarad.";
        link_capacitance_max_nf: u32 100..=1_000_000, "Largest C2 with which the place of the zero crossing is judged, in nanofarad.";
        bleeder_ohm: u32 1_000..=10_000_000, "Bleeder of the DC link, in ohm.";
    }
    bridge {
        dead_time_ns: u32 100..=3_000, "Dead time between the two switches, in nanosecond.";
        node_capacitance_nf: u32 1..=100, "Capacitance of the bridge's node (both switches and their snubbers), in nanofarad.";
        trip_delay_ns: u32 0..=10_000, "Time from the comparators' pin above its level to an open switch, without the filter of the fault input, in nanosecond.";
        resonance_capacitance_nf: u32 100..=10_000, "Series resonance capacitor C_r, in nanofarad.";
    }
    coil {
        coil_turns: u32 7..=27, "Turns of the coil; with fewer or more a pot's inductance is outside the 2 to 64 µH of the lookup.";
        coil_inner_um: u32 0..=500_000, "Inner radius of the coil, in micrometre.";
        coil_outer_um: u32 10_000..=500_000, "Outer radius of the coil, in micrometre.";
        coil_thickness_um: u32 100..=50_000, "Thickness of the coil, in micrometre.";
        pot_gap_um: u32 100..=50_000, "Distance from the coil to a pot's base, glass included, in micrometre.";
        ferrite_gap_um: u32 100..=50_000, "Distance from the ferrite to the coil, in micrometre.";
        ferrite_thickness_um: u32 100..=50_000, "Thickness of the ferrite, a plate in the simulation, in micrometre.";
        ferrite_radius_um: u32 10_000..=500_000, "Outer radius of the ferrite, in micrometre.";
        ferrite_mu_r: u32 1..=100_000, "Relative permeability of the ferrite.";
        shield_gap_um: u32 100..=50_000, "Distance from the aluminium shield to the ferrite, in micrometre.";
        shield_thickness_um: u32 0..=50_000, "Thickness of the aluminium shield, in micrometre; 0 is a perfect conductor.";
        winding_mohm: u32 1..=1_000, "Resistance of the winding and its leads, in milliohm.";
        bare_coil_nh: u32 1_000..=64_000, "Inductance of the coil with nothing on it, at the probe frequency, in nanohenry: a pot probe without a pot tests the current's gain with it.";
    }
    front_end {
        coil_divider_ohm: u32 10_000..=10_000_000, "Resistance of each chain of the coil voltage's divider, in ohm.";
        coil_divider_bottom_ohm: u32 10..=100_000, "Resistor below each of these chains, in ohm.";
        current_transformer_turns: u32 10..=10_000, "Turns of the current transformer's secondary winding, for one of its primary.";
        current_transformer_mh: u32 1..=100_000, "Inductance of that winding, in millihenry.";
        current_transformer_mohm: u32 0..=1_000_000, "Resistance of that winding, in milliohm.";
        burden_mohm: u32 100..=1_000_000, "Burden of the current transformer, in milliohm.";
        bus_divider_ohm: u32 10_000..=100_000_000, "Resistance of the bus divider's chain, in ohm.";
        bus_divider_bottom_ohm: u32 10..=1_000_000, "Resistor below that chain, in ohm.";
        mains_divider_ohm: u32 10_000..=100_000_000, "Resistance of each chain of the mains voltage's divider, in ohm.";
        mains_divider_bottom_ohm: u32 10..=1_000_000, "Resistor below each of these chains, in ohm.";
        pin_ohm: u32 1..=100_000, "Resistor before each pin of the converters, in ohm.";
        fast_pin_pf: u32 10..=1_000_000, "Capacitor at the pins of coil voltage and current, in picofarad.";
        slow_pin_pf: u32 10..=1_000_000, "Capacitor at the pins of bus and mains, in picofarad.";
        bus_divider_pf: u32 10..=1_000_000, "Capacitor at the bottom of the bus divider, in picofarad.";
        mains_amplifier_pf: u32 10..=1_000_000, "Capacitor beside each bottom resistor of the mains voltage's divider, in picofarad.";
    }
    limits {
        planned_current_ma: u32 1_000..=500_000, "Crest of the coil current that power control plans with, in milliampere.";
        soft_current_ma: u32 1_000..=500_000, "Coil current from which the frequency is raised within a block, in milliampere.";
        trip_current_ma: u32 1_000..=500_000, "Coil current that opens both switches, in milliampere.";
        planned_coil_voltage_dv: u32 100..=20_000, "Crest of the coil voltage that power control plans with, in decivolt.";
        soft_coil_voltage_dv: u32 100..=20_000, "Coil voltage from which the frequency is raised within a block, in decivolt.";
        bus_start_max_dv: u16 100..=15_000, "Bus voltage above which the bridge does not begin to switch, in decivolt.";
        bus_trip_dv: u16 100..=15_000, "Bus voltage that opens both switches, in decivolt.";
    }
    thermistors {
        heat_sink_ntc_ohm: u32 1_000..=1_000_000, "Resistance of the heat sink's NTC at 25 °C, in ohm.";
        heat_sink_ntc_b_k: u32 1_000..=6_000, "B of the heat sink's NTC, in kelvin.";
        heat_sink_pull_up_ohm: u32 1_000..=1_000_000, "Resistor from the heat sink's NTC to the converter's reference, in ohm.";
        glass_ntc_ohm: u32 1_000..=1_000_000, "Resistance of the glass's NTC at 25 °C, in ohm.";
        glass_ntc_b_k: u32 1_000..=6_000, "B of the glass's NTC, in kelvin.";
        glass_pull_up_ohm: u32 1_000..=1_000_000, "Resistor from the glass's NTC to the converter's reference, in ohm.";
        coil_ntc_ohm: u32 1_000..=1_000_000, "Resistance of the coil's NTC at 25 °C, in ohm.";
        coil_ntc_b_k: u32 1_000..=6_000, "B of the coil's NTC, in kelvin.";
        coil_pull_up_ohm: u32 1_000..=1_000_000, "Resistor from the coil's NTC to the converter's reference, in ohm.";
    }
}
