//! Every limit of control and protection, in one table. No limit here can be changed by the host, and
//! none depends on a lookup. docs/control.md is generated from it.
//!
//! Currents go up in steps: what control plans with (70 A), what is corrected within a block (73 A),
//! what trips (76 A, the comparator at one crest, samples by three of a block), what the converter can show (80 A). The same for the coil's voltage (540, 590 and 640 V).

use ihd_shared::board;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::Configure;

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct LimitRow {
    /// Name of the constant.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Purpose, and the reason for the value.
    pub doc: &'static str,
}

macro_rules! limits {
    ($($(#[doc = $doc:literal])+ $name:ident: $ty:ty = $value:expr, $unit:literal;)+) => {
        $($(#[doc = $doc])+ pub const $name: $ty = $value;)+

        /// The whole table.
        pub const TABLE: &[LimitRow] = &[$(LimitRow {
            name: stringify!($name),
            value: $name as f64,
            unit: $unit,
            doc: concat!($($doc),+),
        }),+];
    };
}

limits! {
    /// Crest of the coil current that power control plans with, fundamental and third harmonic, at the bus
    /// voltage of now and of a mains that has recovered. The rating of 2500 W into a 21 cm pot takes 64 A
    /// at 230 V and 67 A at 200 V; below, the distance from resonance ends it: 2150 W at 180 V.
    PLANNED_CURRENT_MA: u32 = board::PLANNED_CURRENT_MA, "mA";
    /// Crest of the coil current from here on raises the frequency within a block or two: by [`SOFT_PAIRS`].
    SOFT_CURRENT_MA: u32 = board::SOFT_CURRENT_MA, "mA";
    /// Crest of the coil current from here on opens both switches: the comparator at once, [`TRIP_PAIRS`] samples of a block after it.
    TRIP_CURRENT_MA: u32 = board::TRIP_CURRENT_MA, "mA";
    /// Crest of the coil voltage that power control plans with.
    PLANNED_COIL_VOLTAGE_DV: u32 = board::PLANNED_COIL_VOLTAGE_DV, "dV";
    /// Crest of the coil voltage from here on raises the frequency within a block or two: by [`SOFT_PAIRS`].
    SOFT_COIL_VOLTAGE_DV: u32 = board::SOFT_COIL_VOLTAGE_DV, "dV";
    /// The lower switch is closed for at least this long before the bridge switches. The bootstrap
    /// capacitor charges with 10 ohm × 1 µF = 10 µs, through a diode that takes its last tenths of a volt
    /// slowly; a board with ten times of both still has ten time constants.
    BOOTSTRAP_CHARGE_NS: u32 = 1_000_000, "ns";
    /// A lower switch closed for so long has seen a whole half-cycle: a bus that did not go down in it is
    /// a link that nothing discharges.
    IDLE_LINK_NS: u32 = 25_000_000, "ns";
    /// Bus voltage that opens both switches.
    BUS_TRIP_DV: u16 = board::BUS_TRIP_DV, "dV";
    /// For so long the bus may be above that while the bridge does not switch. Where it opens at the mains' crest, the line's
    /// inductance charges the link: 533 V at 265 V and 2500 W behind 0.8 mH, of which the bleeder leaves 420 V after 105 ms.
    BUS_SURGE_NS: u32 = 500_000_000, "ns";
    /// Bus voltage above which the bridge does not begin to switch: the crest of 265 V is 375 V.
    BUS_START_MAX_DV: u16 = board::BUS_START_MAX_DV, "dV";
    /// Below this highest bus voltage of a half-cycle nothing is heated and nothing judged.
    BUS_MIN_DV: u16 = 250, "dV";
    /// Below this one readings are not compared with each other: 100 V.
    COMPARED_FROM_DV: u16 = 1_000, "dV";
    /// Bus voltage below which the mains is at its zero, or away.
    BUS_DOWN_DV: u16 = 150, "dV";
    /// For so long the bus may be down while the bridge switches; then both switches open until the
    /// next zero crossing. The mains passes its zero in 0.4 ms at 180 V and 45 Hz, in 1 ms at 70 V.
    BUS_DOWN_NS: u32 = 1_500_000, "ns";
    /// While the bus is below this share of what it was, the power is not raised: the mains may
    /// come back at once.
    SAG_PERCENT: u32 = 85, "%";
    /// So long a lower bus voltage lasts before it counts as the new one.
    SAG_FORGOTTEN_MS: u32 = 10_000, "ms";
    /// Reactance above resonance that power control keeps, of the coil's.
    RESONANCE_MARGIN_PERCENT: i64 = 12, "%";
    /// With less than this for [`SOFT_RESONANCE_SHORTAGE_PERCENT`], the frequency is raised.
    SOFT_RESONANCE_PERCENT: u32 = 4, "%";
    /// Shortage of reactance that raises the frequency, summed over blocks: a coil in resonance has it after three. Below
    /// [`SOFT_RESONANCE_FROM_MA`] a block counts by its current squared, as its noise is larger and its harm less.
    SOFT_RESONANCE_SHORTAGE_PERCENT: i64 = 12, "%·blocks";
    /// Amplitude of the coil current from which on a block counts in full.
    SOFT_RESONANCE_FROM_MA: u32 = 16_000, "mA";
    /// Blocks in a row with the estimate below resonance or at its bound that open both switches:
    /// 0.3 to 0.7 ms, more than the estimator takes to settle.
    ESTIMATE_BLOCKS: u8 = 8, "blocks";
    /// Turn-off current that power control keeps, of what the node's charge needs within the dead time.
    TURN_OFF_PERCENT: u32 = 150, "%";
    /// With less than this for [`SOFT_TURN_OFF_SHORTAGE_MA`], the frequency is raised.
    SOFT_TURN_OFF_PERCENT: u32 = 115, "%";
    /// Shortage of turn-off current that raises the frequency, summed over blocks for each switch: a current that turns off at zero
    /// at 325 V has it after six blocks (0.2 to 0.5 ms, at most 36 edges of 1 mJ), one that leads by 26 A after one.
    SOFT_TURN_OFF_SHORTAGE_MA: i32 = 32_000, "mA·blocks";
    /// Below this bus voltage a hard edge costs less than 7 µJ, and turn-off current is not checked.
    SOFT_SWITCHING_FROM_DV: u16 = 500, "dV";
    /// Least step of the frequency at a soft limit.
    SOFT_STEP_PERMILLE: u32 = 80, "permille";
    /// Blocks until the next soft limit may act: new periods begin a block later, and the tank follows
    /// within another.
    SOFT_HOLD_BLOCKS: u8 = 3, "blocks";
    /// For so long a frequency at which a soft limit acted is not gone below.
    SOFT_REMEMBERED_MS: u32 = 600, "ms";
    /// For so long the frequency at which a pot was lifted is not gone below.
    LIFT_REMEMBERED_MS: u32 = 2_000, "ms";
    /// Largest step towards more power per half-cycle, with a lookup that holds no observation.
    STEP_DOWN_HZ: u32 = 2_500, "Hz";
    /// The same where the lookup rests on observations and agrees with what is measured, and on the way
    /// back to where the same pot was heated.
    TAUGHT_STEP_DOWN_HZ: u32 = 30_000, "Hz";
    /// Largest step towards less power per half-cycle.
    STEP_UP_HZ: u32 = 8_000, "Hz";
    /// Deviation from the request that is near enough.
    DEAD_BAND_PERCENT: u32 = 2, "%";
    /// Share of the rating that a small pot gets: it takes the whole flux on a small base.
    SMALL_POT_PERCENT: u16 = 50, "%";
    /// Longest time that the bridge switches without a pot that was judged.
    UNJUDGED_MS: u32 = 60, "ms";
    /// Half-cycles in a row without a pot that end heating.
    POT_GONE_HALF_CYCLES: u8 = 2, "half-cycles";
    /// Amplitude of the coil current below which no pot can be judged.
    POT_CURRENT_MIN_MA: u32 = 1_500, "mA";
    /// Duration of a pot probe, from a zero crossing on: it ends before the crest, with at
    /// most 2 J into any pot at 265 V, 3.4 J into household foil.
    PROBE_NS: u32 = 3_300_000, "ns";
    /// Frequency of the second pot probe, of what may be a sheet thinner than its skin depth.
    SECOND_PROBE_HZ: u32 = 50_000, "Hz";
    /// Duration of the second pot probe: with three times the power of the first at the same bus voltage it ends sooner.
    SECOND_PROBE_NS: u32 = 2_200_000, "ns";
    /// From one pot probe to the next, in the first time after one was taken away: it may be on
    /// its way back.
    QUICK_PROBE_MS: u32 = 200, "ms";
    /// Duration of that first time.
    QUICK_PROBES_FOR_MS: u32 = 1_600, "ms";
    /// From one pot probe to the next after it.
    PROBE_MS: u32 = 700, "ms";
    /// Waiting for a pot ends after this, unless the host sets another time, 60 to 600 s.
    GIVE_UP_MS: u32 = Configure::DEFAULT.give_up_s as u32 * 1_000, "ms";
    /// Starts again after trips before the lock-out.
    TRIES: u8 = 4, "tries";
    /// Pause before the first of them: a mains that jumped, or a sensor that was wrong for a moment. The link's surge is down by then.
    QUICK_PAUSE_MS: u32 = 100, "ms";
    /// Pause before the second; each further one is twice as long.
    SECOND_PAUSE_MS: u32 = 1_000, "ms";
    /// Pause after a fault of the mains, or one that lasts as long as its cause; it counts no try.
    MAINS_PAUSE_MS: u32 = 200, "ms";
    /// Heating without a trip for so long gives a try back.
    GOOD_RUN_MS: u32 = 10_000, "ms";
    /// Above the frequency at which a trip opened the bridge: so much higher is where the search of the next start begins.
    RESUME_ABOVE_PERCENT: u32 = 15, "%";
    /// Power within a burst, at least: 28.8 % of the rating.
    BURST_POWER_W: u16 = (RATED_POWER_W as u32 * 288 / 1_000) as u16, "W";
    /// From one burst to the next: ten seconds have a whole number of them.
    BURST_PERIOD_MS: u32 = 1_000, "ms";
    /// Half-cycles from the release of a shared supply to the end of the burst: the other zone's lower switch is closed for
    /// [`IDLE_LINK_NS`] before it begins.
    HANDOVER_HALF_CYCLES: u32 = 4, "half-cycles";
    /// Longest burst while a supply is shared.
    SHARED_BURST_HALF_CYCLES: u32 = 240, "half-cycles";
    /// For so long, once in `BURST_PERIOD_MS`, a zone that heats alone lets go of the wire of a shared supply: the other one may pull it.
    OFFER_MS: u16 = 5, "ms";
    /// For so long after its last pull the other zone of a shared supply counts as on.
    OTHER_ZONE_SILENT_MS: u16 = 3_000, "ms";
    /// Blocks lost in a half-cycle that are still an interrupt that came late.
    LOST_BLOCKS: u32 = 2, "blocks";
    /// Pairs at the end of the converters' range in a block that mean a broken sensor and not a spike.
    SATURATED_PAIRS: u16 = 16, "pairs";
    /// Samples beyond a soft limit of current or voltage that act: together, less one a block, so that noise does not. A crest 1 % above
    /// has six in a block.
    SOFT_PAIRS: u16 = 3, "pairs";
    /// Samples of a block beyond the trip level that trip. A crest 1 % above has five; the comparator needs none of them.
    TRIP_PAIRS: u16 = 3, "pairs";
    /// Without a zero crossing for so long the mains is gone.
    MAINS_LOST_NS: u32 = 30_000_000, "ns";
    /// A zero crossing sooner than this after the last one is an echo of it.
    SHORTEST_HALF_CYCLE_NS: i64 = 7_000_000, "ns";
    /// Shortest half-cycle of a mains that is as it must be: 66 Hz.
    HALF_CYCLE_MIN_NS: u32 = 7_576_000, "ns";
    /// Longest: 44 Hz, as 45 Hz must heat.
    HALF_CYCLE_MAX_NS: u32 = 11_364_000, "ns";
    /// Half-cycles of another length, or zero crossings away from the bus's zero, among the last eight
    /// that stop heating.
    IRREGULAR_HALF_CYCLES: u32 = 3, "of 8";
    /// At a zero crossing with more than this on the bus, the bridge does not begin to switch: it is no
    /// zero crossing, but a mains that came back. A link that nothing discharges is excepted.
    BUS_AT_START_DV: u16 = 600, "dV";
    /// Share of its peak that the bus may have at a zero crossing, where the load discharges the link.
    BUS_AT_CROSSING_PERCENT: u32 = 20, "%";
    /// Largest capacitance of the DC link for that: with less power than discharges it to 15 % the crossing's place is not judged.
    LINK_CAPACITANCE_MAX_NF: u32 = board::LINK_CAPACITANCE_MAX_NF, "nF";
    /// Half-cycles in a row that an implausible reading lasts before it is a fault.
    IMPLAUSIBLE_HALF_CYCLES: u8 = 4, "half-cycles";
    /// By so much coil voltage plus that of the resonance capacitor may differ from the bridge's, whatever the load: the gains of
    /// voltage and bus, noise of 20 dB.
    BALANCE_PERCENT: u32 = 5, "%";
    /// By so much more, times X_C·X/|Z|²: what C_r and the gain of the current add. 2.2 % at 1500 W, 2.8 % at 2500 W, at most 6 %.
    BALANCE_TANK_PERCENT: u32 = 6, "%";
    /// Up to so much R at a pot probe there is the coil alone, or metal that takes next to nothing: three times the winding's.
    BARE_COIL_MOHM: u32 = 3 * board::WINDING_MOHM, "mohm";
    /// By so much coil voltage plus that of the resonance capacitor may differ from the bridge's at a pot probe with a load, where
    /// the bus changes within the estimator's delay.
    PROBE_BALANCE_PERCENT: u32 = 10, "%";
    /// By so much the bare coil's L may be above that of the board's file, and its voltage differ from the bridge's.
    BARE_COIL_PERCENT: u32 = 4, "%";
    /// By so much a gain of current or voltage may have drifted, by the L of a pot that stays and the balance together. Honest boards
    /// show 2 % at most: 180 to 265 V, C2 from 1 to 10 µF, 20 dB of noise, pots that are moved and get warm.
    GAIN_DRIFT_PERMILLE: i32 = 35, "permille";
    /// By so much the power into the coil may differ from the DC link's, where a sensor is fitted.
    POWER_BALANCE_PERCENT: u32 = 12, "%";
    /// Mean of the coil current over whole periods: the capacitor lets none through.
    CURRENT_OFFSET_MA: u32 = 3_000, "mA";
    /// Mean of the coil voltage over whole periods: the winding holds none.
    VOLTAGE_OFFSET_DV: u32 = 200, "dV";
    /// Lowest analogue supply that readings are corrected for: 2.4 % below 3.3 V are 4.9 % of power, which a reference that
    /// is wrong instead would cost.
    SUPPLY_MIN_MV: u32 = 3_221, "mV";
    /// Highest.
    SUPPLY_MAX_MV: u32 = 3_379, "mV";
    /// Readings of the reference in a row, one every 4 ms, outside this range that stop heating, and within it that permit it.
    SUPPLY_READINGS: u8 = 3, "readings";
    /// Blocks in a row that are alike to the last bit.
    FROZEN_BLOCKS: u8 = 4, "blocks";
    /// Heat sink from which power is taken back.
    SINK_DERATE_C: i16 = 85, "°C";
    /// Heat sink at which none is left.
    SINK_OFF_C: i16 = 105, "°C";
    /// Glass from which power is taken back.
    GLASS_DERATE_C: i16 = 260, "°C";
    /// Glass at which none is left.
    GLASS_OFF_C: i16 = 300, "°C";
    /// Base of a pot, as the glass lets it be estimated, from which power is taken back.
    POT_HOT_C: i16 = 230, "°C";
    /// Base at which only the lowest level's power is left.
    POT_TOO_HOT_C: i16 = 260, "°C";
    /// Lead of a pot's base over the glass's sensor: heat capacity of the glass by half of a flat base's conductance, and the sensor's lag.
    POT_LEAD_S: i16 = 80, "s";
    /// Conductance from the glass to the room by half of a flat base's.
    POT_LOSS_PERCENT: i16 = 38, "%";
    /// Base that is kept warm without power: contents of 70 °C take 50 to 150 W.
    KEEP_WARM_C: i16 = 76, "°C";
    /// Power for each degree below it.
    KEEP_WARM_W_PER_K: i16 = 50, "W/K";
    /// Conductance from the glass to the room by .8 of a flat base's, to which keeping warm regulates.
    KEEP_WARM_LOSS_PERCENT: i16 = 24, "%";
    /// Level of the panel whose power and time are the most of keeping warm.
    KEEP_WARM_LEVEL: u8 = 3, "level";
    /// Coil from which power is taken back.
    COIL_DERATE_C: i16 = 140, "°C";
    /// Coil at which none is left.
    COIL_OFF_C: i16 = 180, "°C";
    /// Heat sink from which the fan runs.
    FAN_ON_C: i16 = 50, "°C";
    /// Heat sink below which it stops.
    FAN_OFF_C: i16 = 42, "°C";
    /// Off for so long gives a used-up time without a touch of the panel back.
    REST_MIN: u16 = 60, "min";
    /// Time above the second-highest level; then that level, and as long until the next boost.
    BOOST_MIN: u16 = 10, "min";
    /// Glass from which it is shown as hot.
    GLASS_HOT_C: i16 = 60, "°C";
    /// Glass below which it is no longer.
    GLASS_COOL_C: i16 = 50, "°C";
    /// Largest dither of the switching frequency that can be set.
    DITHER_MAX_PERMILLE: u8 = *Configure::DITHER_PERMILLE.end(), "permille";
}

/// A level of the panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PowerLevel {
    /// Power, in watt.
    pub power_w: u16,
    /// Time at this level after which the hob switches off, unless somebody touches the panel, in minutes.
    pub unattended_min: u16,
}

/// Levels 1 to 9, as shares of the rating.
pub const LEVELS: [PowerLevel; 9] = {
    const fn level(percent: u32, unattended_min: u16) -> PowerLevel {
        PowerLevel {
            power_w: (RATED_POWER_W as u32 * percent / 100) as u16,
            unattended_min,
        }
    }
    [
        level(4, 600),
        level(8, 480),
        level(14, 360),
        level(20, 300),
        level(28, 240),
        level(40, 180),
        level(56, 120),
        level(76, 90),
        level(100, 60),
    ]
};

/// Highest power that keeps warm, in watt.
pub const KEEP_WARM_W: u16 = LEVELS[KEEP_WARM_LEVEL as usize - 1].power_w;

impl PowerLevel {
    /// The lowest level with at least this power; `None` for 0 W.
    pub fn of_power(power_w: u16) -> Option<Self> {
        let [.., highest] = LEVELS;
        let level = LEVELS.into_iter().find(|level| power_w <= level.power_w);
        (power_w > 0).then_some(level.unwrap_or(highest))
    }
}

// The steps of each quantity are in order; those of the board's file are checked with it (boards/src/order.rs).
const _: () = assert!(
    (SOFT_RESONANCE_PERCENT as i64) < RESONANCE_MARGIN_PERCENT
        && SOFT_TURN_OFF_PERCENT < TURN_OFF_PERCENT
);
