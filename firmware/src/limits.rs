//! Limits of control and protection in one table. The host can change none of them but [`GIVE_UP_MS`], and none depends on a
//! lookup. docs/control.md is generated from it.
//!
//! Levels of the coil current, in rising order: planned by power control (70 A), corrected within a block (73 A), trip (76 A, by
//! the comparator at one crest, by three samples of a block), full scale of the converter (80 A). Likewise for the coil voltage:
//! 540, 590 and 640 V.

use ihd_shared::board;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::Configure;

/// Row of the table.
#[derive(Clone, Copy, Debug)]
pub struct LimitRow {
    /// Name of the constant.
    pub name: &'static str,
    /// Value of the constant.
    pub value: f64,
    /// Unit of the value.
    pub unit: &'static str,
    /// Purpose, and the reason for the value.
    pub doc: &'static str,
}

macro_rules! limits {
    ($($(#[doc = $doc:literal])+ $name:ident: $ty:ty = $value:expr, $unit:literal;)+) => {
        $($(#[doc = $doc])+ pub const $name: $ty = $value;)+

        /// All limits, in the order of their definition.
        pub const TABLE: &[LimitRow] = &[$(LimitRow {
            name: stringify!($name),
            value: $name as f64,
            unit: $unit,
            doc: concat!($($doc),+),
        }),+];
    };
}

limits! {
    /// Crest of the coil current that power control plans with, fundamental and third harmonic, at the present bus voltage and at
    /// that of a recovered mains. The rating of 2500 W into a 21 cm pot takes 64 A at 230 V and 67 A at 200 V; below, the
    /// distance from resonance limits it: 2150 W at 180 V.
    PLANNED_CURRENT_MA: u32 = board::PLANNED_CURRENT_MA, "mA";
    /// Crest of the coil current that raises the frequency within a block or two: by [`SOFT_PAIRS`].
    SOFT_CURRENT_MA: u32 = board::SOFT_CURRENT_MA, "mA";
    /// Crest of the coil current that opens both switches: the comparator at once, [`TRIP_PAIRS`] samples of a block after it.
    TRIP_CURRENT_MA: u32 = board::TRIP_CURRENT_MA, "mA";
    /// Crest of the coil voltage that power control plans with.
    PLANNED_COIL_VOLTAGE_DV: u32 = board::PLANNED_COIL_VOLTAGE_DV, "dV";
    /// Crest of the coil voltage that raises the frequency within a block or two: by [`SOFT_PAIRS`].
    SOFT_COIL_VOLTAGE_DV: u32 = board::SOFT_COIL_VOLTAGE_DV, "dV";
    /// Shortest time with the lower switch closed before the bridge switches. The bootstrap capacitor charges with 10 ohm × 1
    /// µF = 10 µs, at the end slowly through its diode; a board with 100 µs still has ten time constants.
    BOOTSTRAP_CHARGE_NS: u32 = 1_000_000, "ns";
    /// Time with the lower switch closed that contains a whole half-cycle: a bus that is still high after it is a link that
    /// nothing discharges.
    IDLE_LINK_NS: u32 = 25_000_000, "ns";
    /// Bus voltage that opens both switches.
    BUS_TRIP_DV: u16 = board::BUS_TRIP_DV, "dV";
    /// Bus voltage from which power control lowers the frequency no further. The current swings a bus of 4.7 µF 4 V above the crest
    /// of 265 V, one of 1 µF 90 V above that of 230 V, and the last step adds a third of it.
    PLANNED_BUS_DV: u16 = (board::BUS_TRIP_DV as u32 * 96 / 100) as u16, "dV";
    /// Bus voltage from which it does so in quarters of [`STEP_DOWN_HZ`].
    NEAR_BUS_DV: u16 = (board::BUS_TRIP_DV as u32 * 92 / 100) as u16, "dV";
    /// Longest time of a bus above [`BUS_TRIP_DV`] while the bridge does not switch. If it opens at the mains' crest, the line's
    /// inductance charges the link: 533 V at 265 V and 2500 W behind 0.8 mH, of which bleeder and divider leave 420 V after 96 ms.
    BUS_SURGE_NS: u32 = 500_000_000, "ns";
    /// Bus voltage above which the bridge does not begin to switch: the crest of 265 V is 375 V.
    BUS_START_MAX_DV: u16 = board::BUS_START_MAX_DV, "dV";
    /// Peak bus voltage of a half-cycle below which there is no heating and no pot is judged.
    BUS_MIN_DV: u16 = 250, "dV";
    /// Peak bus voltage below which readings are not compared with each other.
    COMPARED_FROM_DV: u16 = 1_000, "dV";
    /// Bus voltage below which the mains is at its zero, or lost.
    BUS_DOWN_DV: u16 = 150, "dV";
    /// Longest time of a bus that is down while the bridge switches; then both switches open until the next zero crossing. The
    /// mains passes its zero in 0.4 ms at 180 V and 45 Hz, in 1 ms at 70 V.
    BUS_DOWN_NS: u32 = 1_500_000, "ns";
    /// Share of the previous bus voltage below which the power is not raised: the mains may recover at once.
    SAG_PERCENT: u32 = 85, "%";
    /// Time after which a lower bus voltage counts as the new one.
    SAG_FORGOTTEN_MS: u32 = 10_000, "ms";
    /// Reactance above resonance that power control keeps, as a share of the coil's.
    RESONANCE_MARGIN_PERCENT: i64 = 12, "%";
    /// Least reactance above resonance; a shortage of [`SOFT_RESONANCE_SHORTAGE_PERCENT`] raises the frequency.
    SOFT_RESONANCE_PERCENT: u32 = 4, "%";
    /// Shortage of reactance, summed over blocks, that raises the frequency: a coil in resonance has it after three. Below
    /// [`SOFT_RESONANCE_FROM_MA`] a block counts by its current squared, as its noise is larger and its harm less.
    SOFT_RESONANCE_SHORTAGE_PERCENT: i64 = 12, "%·blocks";
    /// Amplitude of the coil current from which a block counts in full.
    SOFT_RESONANCE_FROM_MA: u32 = 16_000, "mA";
    /// Consecutive blocks with the estimate below resonance or at its bound that open both switches: 0.3 to 0.7 ms, more than the
    /// estimator takes to settle.
    ESTIMATE_BLOCKS: u8 = 8, "blocks";
    /// Turn-off current that power control keeps, relative to what brings the node to the other rail within the dead time.
    TURN_OFF_PERCENT: i32 = 150, "%";
    /// Least turn-off current; a shortage of [`SOFT_TURN_OFF_SHORTAGE_MA`] raises the frequency.
    SOFT_TURN_OFF_PERCENT: i32 = 115, "%";
    /// Shortage of turn-off current, summed over blocks for each switch, that raises the frequency: a turn-off at zero current at
    /// 325 V has it after six blocks (0.2 to 0.5 ms, at most 36 edges of 1 mJ), a lead by 26 A after one.
    SOFT_TURN_OFF_SHORTAGE_MA: i32 = 32_000, "mA·blocks";
    /// Bus voltage below which a hard edge costs less than 19 µJ and turn-off current is not checked.
    SOFT_SWITCHING_FROM_DV: u16 = 500, "dV";
    /// Smallest step of the frequency at a soft limit.
    SOFT_STEP_PERMILLE: u32 = 80, "permille";
    /// Blocks until the next soft limit may act: new periods begin a block later, and the tank follows
    /// within another.
    SOFT_HOLD_BLOCKS: u8 = 3, "blocks";
    /// Time for which the frequency at which a soft limit acted is a lower bound.
    SOFT_REMEMBERED_MS: u32 = 600, "ms";
    /// Time for which the frequency at which a pot was lifted is a lower bound.
    LIFT_REMEMBERED_MS: u32 = 2_000, "ms";
    /// Largest step towards more power per half-cycle, with a lookup without observations.
    STEP_DOWN_HZ: u32 = 2_500, "Hz";
    /// Largest such step if the lookup rests on observations and agrees with the measurement, or on the way back to a point of
    /// the same pot.
    TAUGHT_STEP_DOWN_HZ: u32 = 30_000, "Hz";
    /// Largest step towards less power per half-cycle.
    STEP_UP_HZ: u32 = 8_000, "Hz";
    /// Deviation from the request that is not corrected.
    DEAD_BAND_PERCENT: u32 = 2, "%";
    /// Share of the rating for a small pot, whose small base takes the whole flux.
    SMALL_POT_PERCENT: u16 = 50, "%";
    /// Longest time that the bridge switches without a judged pot.
    UNJUDGED_MS: u32 = 60, "ms";
    /// Consecutive half-cycles without a pot that end heating.
    POT_GONE_HALF_CYCLES: u8 = 2, "half-cycles";
    /// Half-cycles without power after which a probe looks for the pot before the next burst.
    UNSEEN_HALF_CYCLES: u32 = 25, "half-cycles";
    /// The same without a burst that is due, or while the other zone has the supply.
    UNSEEN_WAITING_HALF_CYCLES: u32 = 70, "half-cycles";
    /// Amplitude of the coil current below which no pot can be judged.
    POT_CURRENT_MIN_MA: u32 = 1_500, "mA";
    /// Duration of a pot probe from a zero crossing: it ends before the crest, with at most 2 J into any pot at 265 V, 3.4 J into
    /// household foil.
    PROBE_NS: u32 = 3_300_000, "ns";
    /// Amplitude of the coil current that ends a pot probe earlier: no pot takes half of it, and aluminium as much, which the ripple
    /// of a link of 1 µF doubles.
    PROBE_CURRENT_MA: u32 = board::TRIP_CURRENT_MA * 55 / 76, "mA";
    /// Frequency of the second pot probe, for a possible sheet thinner than its skin depth.
    SECOND_PROBE_HZ: u32 = 50_000, "Hz";
    /// Duration of the second pot probe: shorter, as its power is three times that of the first at the same bus voltage.
    SECOND_PROBE_NS: u32 = 2_200_000, "ns";
    /// Period of the pot probes just after a pot was removed: it may return.
    QUICK_PROBE_MS: u32 = 200, "ms";
    /// Duration of these pot probes.
    QUICK_PROBES_FOR_MS: u32 = 1_600, "ms";
    /// Period of the pot probes after them.
    PROBE_MS: u32 = 700, "ms";
    /// Longest time of waiting for a pot, unless the host sets another one, 60 to 600 s.
    GIVE_UP_MS: u32 = Configure::DEFAULT.give_up_s as u32 * 1_000, "ms";
    /// Restarts after trips before the lock-out.
    TRIES: u8 = 4, "tries";
    /// Pause before the first restart: for a jump of the mains, or a sensor that was wrong for a moment. The link's surge is over
    /// by then.
    QUICK_PAUSE_MS: u32 = 100, "ms";
    /// Pause before the second restart; each further one is twice as long.
    SECOND_PAUSE_MS: u32 = 1_000, "ms";
    /// Pause after a fault of the mains, or one that lasts as long as its cause; it costs no try.
    MAINS_PAUSE_MS: u32 = 200, "ms";
    /// Half-cycles with power, of one run without a trip or a pot that goes, that give a try back.
    GOOD_RUN_HALF_CYCLES: u16 = 1_000, "half-cycles";
    /// Margin above the tripping frequency at which the next search begins.
    RESUME_ABOVE_PERCENT: u32 = 15, "%";
    /// Least power within a burst: 28.8 % of the rating.
    BURST_POWER_W: u16 = (RATED_POWER_W as u32 * 288 / 1_000) as u16, "W";
    /// Period of the bursts: ten seconds are a whole number of them.
    BURST_PERIOD_MS: u32 = 1_000, "ms";
    /// Half-cycles from the release of a shared supply to the end of the burst: the other zone's lower switch is closed for
    /// [`IDLE_LINK_NS`] before its burst.
    HANDOVER_HALF_CYCLES: u32 = 4, "half-cycles";
    /// Longest burst while a supply is shared.
    SHARED_BURST_HALF_CYCLES: u32 = 240, "half-cycles";
    /// Time, once in `BURST_PERIOD_MS`, for which a zone that heats alone releases the wire of a shared supply: the other one may
    /// pull it.
    OFFER_MS: u16 = 5, "ms";
    /// Time after its last pull for which the other zone of a shared supply counts as on.
    OTHER_ZONE_SILENT_MS: u16 = 3_000, "ms";
    /// Most lost blocks in a half-cycle that count as a late interrupt.
    LOST_BLOCKS: u32 = 2, "blocks";
    /// Pairs at the end of the converters' range in a block that indicate a broken sensor, not a spike.
    SATURATED_PAIRS: u16 = 16, "pairs";
    /// Samples beyond a soft limit of current or voltage that act: their sum, less one a block against noise. A crest 1 % above
    /// has six in a block.
    SOFT_PAIRS: u16 = 3, "pairs";
    /// Samples of a block beyond the trip level that trip. A crest 1 % above has five; the comparator needs none of them.
    TRIP_PAIRS: u16 = 3, "pairs";
    /// Longest time without a zero crossing before the mains counts as lost.
    MAINS_LOST_NS: u32 = 30_000_000, "ns";
    /// Shortest time between zero crossings; an earlier one is an echo.
    SHORTEST_HALF_CYCLE_NS: i64 = 7_000_000, "ns";
    /// Shortest half-cycle of a regular mains: 66 Hz.
    HALF_CYCLE_MIN_NS: u32 = 7_576_000, "ns";
    /// Longest half-cycle of a regular mains: 44 Hz, as 45 Hz must still heat.
    HALF_CYCLE_MAX_NS: u32 = 11_364_000, "ns";
    /// Half-cycles among the last eight that stop heating: of another length, or with the zero crossing away from the bus's zero.
    IRREGULAR_HALF_CYCLES: u32 = 3, "of 8";
    /// Bus voltage at a zero crossing above which the bridge does not begin to switch: the mains has just returned. A link that
    /// nothing discharges is excepted.
    BUS_AT_START_DV: u16 = 600, "dV";
    /// Largest share of its peak that the bus may have at a zero crossing, if the load discharges the link.
    BUS_AT_CROSSING_PERCENT: u32 = 20, "%";
    /// Largest capacitance of the DC link for this check: below the power that discharges it to 15 % the crossing is not judged.
    LINK_CAPACITANCE_MAX_NF: u32 = board::LINK_CAPACITANCE_MAX_NF, "nF";
    /// Consecutive half-cycles of an implausible reading that are a fault.
    IMPLAUSIBLE_HALF_CYCLES: u8 = 4, "half-cycles";
    /// Largest relative difference between coil plus capacitor voltage and bridge voltage, for any load: the gains of voltage and
    /// bus, noise of 20 dB.
    BALANCE_PERCENT: u32 = 5, "%";
    /// Additional difference, times X_C·X/|Z|²: by C_r and the gain of the current. 2.2 % at 1500 W, 2.8 % at 2500 W, at most
    /// 6 %.
    BALANCE_TANK_PERCENT: u32 = 6, "%";
    /// Largest R at a pot probe of the coil alone, or of metal that takes next to nothing: three times the winding's.
    BARE_COIL_MOHM: u32 = 3 * board::WINDING_MOHM, "mohm";
    /// Largest relative difference of these voltages at a pot probe with a load, where the bus changes within the estimator's
    /// delay.
    PROBE_BALANCE_PERCENT: u32 = 10, "%";
    /// Largest excess of the bare coil's L over the board file's.
    BARE_COIL_PERCENT: u32 = 4, "%";
    /// Largest relative difference of these voltages at a pot probe of the bare coil: a link of 1 µF rises by 3.7 % within the
    /// estimator's delay.
    BARE_BALANCE_PERMILLE: u32 = 45, "permille";
    /// Largest drift of the gain of current or voltage, by the L of a pot that stays and the balance together. Sound boards show
    /// 2 % at most: 180 to 265 V, C2 from 1 to 10 µF, 20 dB of noise, pots that are moved and get warm.
    GAIN_DRIFT_PERMILLE: i32 = 35, "permille";
    /// Largest relative difference between coil power and DC link power, if a sensor is fitted.
    POWER_BALANCE_PERCENT: u32 = 12, "%";
    /// Mean of the coil current over whole periods that is a fault: the capacitor blocks it.
    CURRENT_OFFSET_MA: u32 = 3_000, "mA";
    /// Mean of the coil voltage over whole periods that is a fault: the winding holds none.
    VOLTAGE_OFFSET_DV: u32 = 200, "dV";
    /// Lowest analogue supply for which readings are corrected: 2.4 % below 3.3 V are 4.9 % of power, the error if the reference
    /// is wrong instead.
    SUPPLY_MIN_MV: u32 = 3_221, "mV";
    /// Highest analogue supply for which readings are corrected.
    SUPPLY_MAX_MV: u32 = 3_379, "mV";
    /// Consecutive readings of the reference, one every 4 ms, that stop heating outside this range and permit it within.
    SUPPLY_READINGS: u8 = 3, "readings";
    /// Time without a block after which hardware opens both switches: a block lasts 88 µs at the lowest frequency, and a thread that
    /// copies a chunk holds it up for 4 µs.
    SAMPLING_WATCHDOG_US: u32 = 500, "µs";
    /// Time that the control loop stands still after which the watchdog resets it, the outputs being off from then on. What must be
    /// faster is in hardware.
    WATCHDOG_US: u32 = 60_000, "µs";
    /// Consecutive blocks, equal to the last bit, that are a fault.
    FROZEN_BLOCKS: u8 = 4, "blocks";
    /// Heat sink temperature from which power is reduced.
    SINK_DERATE_C: i16 = 85, "°C";
    /// Heat sink temperature at which no power is left.
    SINK_OFF_C: i16 = 105, "°C";
    /// Glass temperature from which power is reduced.
    GLASS_DERATE_C: i16 = 260, "°C";
    /// Glass temperature at which no power is left.
    GLASS_OFF_C: i16 = 300, "°C";
    /// Temperature of a pot's base, estimated from the glass, from which power is reduced.
    POT_HOT_C: i16 = 230, "°C";
    /// Base temperature at which only the lowest level's power is left.
    POT_TOO_HOT_C: i16 = 260, "°C";
    /// Lead of a pot's base over the glass's sensor: heat capacity of the glass over half of a flat base's conductance, and the
    /// sensor's lag.
    POT_LEAD_S: i16 = 80, "s";
    /// Conductance from the glass to the room over half of a flat base's.
    POT_LOSS_PERCENT: i16 = 38, "%";
    /// Base temperature at which keeping warm gives no power: contents of 70 °C take 50 to 150 W.
    KEEP_WARM_C: i16 = 76, "°C";
    /// Power for each kelvin below [`KEEP_WARM_C`].
    KEEP_WARM_W_PER_K: i16 = 50, "W/K";
    /// Conductance from the glass to the room over 0.8 of a flat base's, by which keeping warm regulates.
    KEEP_WARM_LOSS_PERCENT: i16 = 24, "%";
    /// Level of the panel whose power and time limit keeping warm.
    KEEP_WARM_LEVEL: u8 = 3, "level";
    /// Coil temperature from which power is reduced.
    COIL_DERATE_C: i16 = 140, "°C";
    /// Coil temperature at which no power is left.
    COIL_OFF_C: i16 = 180, "°C";
    /// Heat sink temperature from which the fan runs.
    FAN_ON_C: i16 = 50, "°C";
    /// Heat sink temperature below which the fan stops.
    FAN_OFF_C: i16 = 42, "°C";
    /// Time off without a break that gives the used time back without a touch of the panel.
    REST_MIN: u16 = 60, "min";
    /// Longest time above the second-highest level; then that level for as long until the next boost.
    BOOST_MIN: u16 = 10, "min";
    /// Glass temperature from which it is shown as hot.
    GLASS_HOT_C: i16 = 60, "°C";
    /// Glass temperature below which it is no longer shown as hot.
    GLASS_COOL_C: i16 = 50, "°C";
    /// Largest dither of the switching frequency that can be set.
    DITHER_MAX_PERMILLE: u8 = *Configure::DITHER_PERMILLE.end(), "permille";
}

/// Level of the panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PowerLevel {
    /// Power, in watt.
    pub power_w: u16,
    /// Time at this level without a touch of the panel after which the hob switches off, in minutes.
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

/// Highest level of the panel.
pub const HIGHEST_LEVEL: u8 = LEVELS.len() as u8;

/// Highest power that keeps warm, in watt.
pub const KEEP_WARM_W: u16 = LEVELS[KEEP_WARM_LEVEL as usize - 1].power_w;

impl PowerLevel {
    /// Lowest level with at least this power; `None` for 0 W.
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
