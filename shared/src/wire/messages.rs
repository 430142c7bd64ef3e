//! The message table: ids, layouts and meanings. docs/protocol.md is generated from it.

use core::ops::RangeInclusive;

use heapless::String;
use serde::{Deserialize, Serialize};

pub use super::enumerations::{ENUMS, Limit, OffReason, Outcome, Piece, Pot, Program, State};
pub use super::message_table::{DecodeError, Message, Request, decode};
use super::message_table::{bind_answer, message_table};
pub use super::raw::Raw;
use super::schema::{Entry, FNV_BASIS, Item, Part, fold_entry};
use crate::fault::Fault;
use crate::sampling::Scales;
use crate::units::{MicroOhm, PicoHenry};

/// Raised by any change of an existing message.
pub const PROTOCOL_MAJOR: u16 = 6;

/// Raised by a new message or a new fault.
pub const PROTOCOL_MINOR: u16 = 0;

message_table! { 'a;
    /// First message in both directions. Frozen for ever: same id, same layout, whatever the version.
    0x01 Both Hello {
        /// [`super::hello::MAGIC`].
        magic: u32,
        /// 0 host, 1 device.
        role: u8,
        /// Incompatible when different.
        protocol_major: u16,
        /// The higher one has more messages.
        protocol_minor: u16,
        /// Hash of the message table; must agree where major and minor do.
        schema_hash: u64,
        /// Bits of [`super::hello`]'s `CAP_` constants.
        capabilities: u32,
        /// Differs from boot to boot.
        boot_id: u32,
        /// 0 power-on, 1 watchdog, 2 panic, 3 brown-out, 4 pin, 5 software, 6 stack overflow.
        reset_reason: u8,
        /// Number of the fault that was active before the reset, 0 for none.
        fault_before_reset: u16,
        /// Name and version of the sender's build.
        build: String<32>,
        /// Board or host name.
        board: String<32>,
    }
    /// Requests power; 0 switches off. More than the rating is taken as the rating, up to 10 000 W. Without a request for 10 s the host's power ends by itself; the panel's goes on.
    0x02 Request SetPower -> Reply {
        /// Mean power over a half-cycle, in watt.
        power_w: u16,
    }
    /// Chooses what the device streams.
    0x03 Request Stream -> Reply {
        /// A `Telemetry` every this many half-cycles; 0 for none.
        telemetry_every: u8,
        /// A window whenever this many half-cycles have passed and the bridge switches at one frequency; 0 for none.
        windows_every: u8,
    }
    /// Asks for a `Status`.
    0x04 Request GetStatus -> Status {}
    /// Offers a lookup ([`crate::lookup::RlLookup::to_bytes`]). It becomes active at the next half-cycle boundary, or at
    /// once while nothing heats, seen in `Status`.
    0x05 Request PushLookup<'a> -> Reply {
        /// The lookup's bytes, its own CRC included.
        #[serde(borrow)]
        blob: Raw<'a>,
    }
    /// Asks for the active lookup.
    0x06 Request ReadLookup -> LookupBlob<'a> {}
    /// Leaves the safe state after a fault; power must be requested again.
    0x07 Request ClearFault -> Reply {}
    /// Enters replay mode: samples come from `ReplayBlocks`, those of the ADC are ignored, and the
    /// power outputs are locked off. The estimator begins anew. Only with the inverter off and no power requested, else
    /// `NotIdle`.
    0x08 Request ReplayStart -> ReplayMode {
        /// Switching frequency of the recording, in hertz, 34 000 to 80 000.
        f_sw_hz: u32,
        /// R that the estimator starts from.
        r: MicroOhm,
        /// L that the estimator starts from.
        l: PicoHenry,
    }
    /// Up to four blocks of 61 pairs for the sampling path. `NotReplaying` when the device is not in replay mode. Without
    /// blocks it asks for the last `ReplayEstimates` again, which a host does that has lost them, or the link.
    0x09 Request ReplayBlocks<'a> -> ReplayEstimates<'a> once {
        /// Index of the first pair after a mains zero crossing; 65535 for none.
        zero_crossing: u16,
        /// Bus voltage, in decivolt.
        bus_dv: u16,
        /// Whole blocks of pairs, [`crate::sampling::Pair::to_le_bytes`] each.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// Leaves replay mode; power must be requested again.
    0x0a Request ReplayEnd -> ReplayMode {}
    /// Asks for a `Utilisation`.
    0x0b Request GetUtilisation -> Utilisation {}
    /// Back to the built-in lookup, version 0, which is kept like any other. It becomes active at the next
    /// half-cycle boundary, or at once while nothing heats, seen in `Status`.
    0x0c Request ResetLookup -> Reply {}
    /// Settings, kept until the next boot.
    0x0d Request Configure -> Reply {
        /// Longest wait for a pot, in seconds: 60 to 600.
        give_up_s: u16,
        /// Dither: the switching frequency moves to either side from half-cycle to half-cycle, in
        /// permille: 0 (not at all) to 10. Never within a window.
        dither_permille: u8,
    }
    /// Asks for a `FrontEnd`.
    0x0e Request GetFrontEnd -> FrontEnd {}
    /// Asks for a piece of a window again, or lets go of the window. A device keeps a window that it has sent until the host
    /// lets go of it, or has said nothing of it for [`super::timing::WINDOW_KEPT_HALF_CYCLES`]; meanwhile windows that are due
    /// are dropped and counted. The piece comes, a chunk being as long as any, or `WindowGone`; nothing on `Nothing`. Keeps
    /// no power on.
    0x0f Notice ResendWindow {
        /// Window.
        seq: u32,
        /// Requested piece.
        piece: Piece,
        /// Index of a chunk's first pair or entry; else 0.
        offset: u16,
    }
    /// Ends the program that runs, for one that begins anew. Only with the inverter off and no power requested,
    /// else `NotIdle`. After `Ok` the device goes, [`super::timing::RESTART_AFTER_MS`] later; sent again, it would meet the
    /// next program.
    0x10 Request Restart -> Reply once {
        /// Program that runs next.
        into: Program,
    }
    /// Asks for a `Board`.
    0x11 Request GetBoard -> Board<'a> {}
    /// Bytes that are known beforehand: a device counts those that come, and sends those that `TestLink` asks for. Not answered.
    0x13 Both LinkData<'a> {
        /// Frames of `LinkData` that this end has sent before this one since the last `TestLink`.
        seq: u32,
        /// At most [`crate::window::CHUNK_BYTES`]; byte k is the lowest byte of `seq` + k.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// Ends one test of the link and begins another: behind the answer so many `LinkData` come, after all else that the
    /// device has to send. `OutOfRange` for more bytes than a `LinkData` takes.
    0x14 Request TestLink -> LinkTested {
        /// `LinkData` to send; 0 for none.
        frames: u16,
        /// Bytes of data in each.
        bytes: u16,
    }
    /// Sends what the firmware logs, from the oldest that is still kept on, in `Log`s; or no more. A `Hello` ends it.
    0x15 Request StreamLog -> Reply {
        /// `true` to stream the log.
        on: bool,
    }
    /// Measures offset and noise of the channels. Only with the inverter off and no power requested, else `Reply` with `NotIdle`; with
    /// `Busy` while another test of the board runs. Answered within a second.
    0x16 Request TestChannels -> Channels {}
    /// Trips both comparators by moving their thresholds. As `TestChannels`.
    0x17 Request TestComparators -> Comparators {}
    /// Counts the clocks against each other. As `TestChannels`.
    0x18 Request TestClocks -> Clocks {}
    /// Answer to a request that has no other, and to any that is not carried out.
    0x80 Answer Reply {
        /// Outcome of the request.
        outcome: Outcome,
        /// See the outcome.
        detail: u32,
    }
    /// The controller now, and everything it has counted since boot.
    0x81 Answer Status {
        /// State of the controller.
        state: State,
        /// Active fault.
        fault: Fault,
        /// Pot on the coil.
        pot: Pot,
        /// Requested power, in watt.
        asked_w: u16,
        /// Mean power of the last half-cycle, in milliwatt.
        delivered_mw: u32,
        /// Switching frequency in hertz; 0 with the inverter off.
        f_sw_hz: u32,
        /// Version of the active lookup; 0 is the built-in prior.
        lookup_version: u32,
        /// Half-cycles since boot.
        half_cycles: u32,
        /// Windows recorded completely.
        windows_recorded: u32,
        /// Windows that were due and found the recorder busy, or that a step of the frequency or a lost block cut short.
        windows_dropped: u32,
        /// Telemetry messages that found their queue full.
        telemetry_dropped: u32,
        /// Frames received with a bad CRC, bad stuffing or a bad length.
        frames_bad: u32,
        /// Frames missing from the host's sequence.
        frames_lost: u32,
        /// Sample pairs at the end of the ADC's range.
        saturated_pairs: u32,
        /// Limit that holds the power below the request.
        limit: Limit,
        /// Restarts left after a trip before the inverter stays off.
        tries_left: u8,
        /// Heat sink, in °C; −300 without a sensor.
        heat_sink_c: i16,
        /// Glass, in °C; −300 without a sensor.
        glass_c: i16,
        /// Coil, in °C; −300 without a sensor.
        coil_c: i16,
        /// `true` while the fan runs.
        fan: bool,
        /// Level chosen at the panel, 0 to 9; 255 while its setting is not in force, as before the first touch, and after a host has switched off.
        panel_level: u8,
        /// `true` while the panel's keys are locked.
        key_locked: bool,
        /// Reason for which the hob has switched itself off.
        off_reason: OffReason,
        /// `true` while the glass is hot enough to burn, or nothing is known of it.
        glass_hot: bool,
        /// Minutes until the panel's timer switches off, rounded up; 0 without one.
        timer_min: u8,
    }
    /// One half-cycle in numbers.
    0x82 Event Telemetry {
        /// Counts every telemetry that was due, sent or not.
        seq: u32,
        /// Telemetry messages dropped since boot.
        dropped: u32,
        /// Half-cycle since boot.
        half_cycle: u32,
        /// State of the controller.
        state: State,
        /// Active fault.
        fault: Fault,
        /// Pot on the coil.
        pot: Pot,
        /// Switching frequency in hertz; 0 with the inverter off.
        f_sw_hz: u32,
        /// Estimated R at the crest of the current.
        r: MicroOhm,
        /// Estimated L at the crest of the current.
        l: PicoHenry,
        /// Largest amplitude of the current's fundamental, in milliampere.
        i_crest_ma: u32,
        /// Mean power of the half-cycle, in milliwatt.
        power_mw: u32,
        /// Lag of the current behind the inverter's voltage at the crest, in milliradian; above
        /// resonance it is positive.
        phase_mrad: i16,
        /// Version of the active lookup.
        lookup_version: u32,
        /// Requested power, in watt.
        asked_w: u16,
        /// Limit that holds the power below the request.
        limit: Limit,
        /// Highest bus voltage of the half-cycle, in decivolt.
        bus_peak_dv: u16,
        /// Largest coil voltage of the half-cycle's samples, in decivolt; that of the fundamental where
        /// no sample is known.
        v_coil_peak_dv: u16,
        /// Smallest current at a turn-off, in milliampere; negative where it flows the wrong way; 0 where none was seen.
        i_turn_off_min_ma: i32,
        /// Reason for which the hob has switched itself off.
        off_reason: OffReason,
        /// `true` while the glass is hot enough to burn, or nothing is known of it.
        glass_hot: bool,
    }
    /// Begins a window ([`crate::window`]).
    0x83 Event WindowStart {
        /// Counts every window that was due, recorded or not.
        seq: u32,
        /// Windows dropped since boot.
        dropped: u32,
        /// Half-cycle since boot.
        half_cycle: u32,
        /// Switching frequency throughout the window, in hertz.
        f_sw_hz: u32,
        /// Duration of the half-cycle, in nanoseconds.
        half_cycle_ns: u32,
        /// Time of the first pair after the mains zero crossing, in nanoseconds.
        first_pair_ns: i32,
        /// Time of the first trajectory entry after the mains zero crossing, in nanoseconds.
        first_trajectory_ns: i32,
        /// Pairs in the window.
        pairs: u16,
        /// Trajectory entries in the window.
        trajectory: u16,
        /// Pairs at the end of the ADC's range.
        saturated: u16,
        /// Version of the lookup that was active.
        lookup_version: u32,
        /// Half the input range of the voltage channel, in millivolt: what code −2048 stands for.
        v_full_scale_mv: u32,
        /// Half the input range of the current channel, in milliampere.
        i_full_scale_ma: u32,
    }
    /// A run of a window's pairs.
    0x84 Event WindowChunk<'a> {
        /// Window.
        seq: u32,
        /// Index of the first pair.
        offset: u16,
        /// Whole pairs, [`crate::sampling::Pair::to_le_bytes`] each.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// A run of a window's trajectory.
    0x85 Event TrajectoryChunk<'a> {
        /// Window.
        seq: u32,
        /// Index of the first entry.
        offset: u16,
        /// Whole entries, [`crate::window::TrajectoryEntry::to_le_bytes`] each.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// Ends a window.
    0x86 Event WindowEnd {
        /// Window.
        seq: u32,
        /// CRC-32 of all pair bytes, then all trajectory bytes.
        crc32: u32,
    }
    /// The active lookup.
    0x87 Answer LookupBlob<'a> {
        /// The lookup's bytes, its own CRC included.
        #[serde(borrow)]
        blob: Raw<'a>,
    }
    /// Sent when a fault trips, and with [`Fault::NONE`] when it is cleared.
    0x88 Event FaultEvent {
        /// Half-cycle since boot in which the fault tripped, or was cleared.
        half_cycle: u32,
        /// The fault.
        fault: Fault,
    }
    /// `true` while samples come from a host; the power outputs are locked off while they do.
    0x89 Answer ReplayMode {
        /// Replay mode.
        active: bool,
        /// Blocks replayed since it was entered.
        blocks: u32,
    }
    /// Estimates from the blocks of one `ReplayBlocks`.
    0x8a Answer ReplayEstimates<'a> {
        /// Blocks replayed before these.
        first: u32,
        /// One [`crate::window::TrajectoryEntry::to_le_bytes`] a block; zeros where a block gave no
        /// estimate.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// Load of the controller since the last `GetUtilisation`.
    0x8b Answer Utilisation {
        /// Blocks of samples whose processing was measured; 0 on a board that cannot measure it.
        blocks: u32,
        /// Share of the processor's time that they took, in permille.
        mean_permille: u16,
        /// The same of the block that took most of its own time.
        worst_permille: u16,
        /// Longest time between two turns of what runs below the sampling path and feeds the
        /// watchdog, in microseconds.
        longest_gap_us: u32,
    }
    /// Scales of the codes of the device's channels.
    0x8c Answer FrontEnd {
        /// Half the input range of the coil voltage's channel, in millivolt.
        v_full_scale_mv: u32,
        /// Half the input range of the coil current's channel, in milliampere.
        i_full_scale_ma: u32,
        /// Largest bus voltage that can be shown, in millivolt; its channel begins at 0.
        bus_full_scale_mv: u32,
        /// Half the input range of the mains voltage's channel, in millivolt.
        mains_full_scale_mv: u32,
        /// Bits of a code.
        bits: u8,
    }
    /// Identity of the device, from its chip and its program. A simulated hob has no chip: its numbers are 0, its
    /// option bytes as they should be.
    0x8d Answer Board<'a> {
        /// DBGMCU_IDCODE: which chip, and its revision.
        id_code: u32,
        /// Flash, in KiB, by the chip (FLASHSIZE).
        flash_kib: u16,
        /// FLASH_OPTR, the user option bytes in force.
        option_bytes: u32,
        /// RCC_CSR as the program found it: why it started.
        reset_flags: u32,
        /// Starts since power came on, this one included; 255 for that many or more.
        starts: u8,
        /// Bytes of the program in flash before its CRC.
        image_bytes: u32,
        /// CRC-32 of these bytes, as it was worked out at start.
        image_crc: u32,
        /// The CRC-32 that the program was sealed with: the word behind its last.
        sealed_crc: u32,
        /// GNU build id of the program, 20 bytes; empty where it has none.
        #[serde(borrow)]
        build_id: Raw<'a>,
        /// The chip's unique number, 12 bytes; empty where there is no chip.
        #[serde(borrow)]
        chip: Raw<'a>,
    }
    /// Offset and noise of the measuring channels with the bridge open. Codes are in 1/256, those of the pairs from mid-scale on.
    0x8e Answer Channels {
        /// Pairs of coil voltage and current that were measured.
        samples: u32,
        /// Mean of the coil voltage's codes.
        v_mean: i32,
        /// Root mean square of the same about the mean.
        v_rms: u32,
        /// Mean of the coil current's codes.
        i_mean: i32,
        /// Root mean square of the same about the mean.
        i_rms: u32,
        /// Codes of bus and mains that were measured.
        slow_samples: u32,
        /// Mean of the bus voltage's codes, which begin at 0.
        bus_mean: i32,
        /// Root mean square of the same about the mean.
        bus_rms: u32,
        /// Mean of the mains voltage's codes.
        mains_mean: i32,
        /// Root mean square of the same about the mean.
        mains_rms: u32,
        /// Code of the chip's reference voltage, whole; 0 where it was not measured.
        reference: u16,
        /// The analogue supply by it, in millivolt; 0 where it was not measured.
        vdda_mv: u16,
    }
    /// Result of a test of the trip in hardware, from the thresholds to the fault inputs, with the bridge open.
    0x8f Answer Comparators {
        /// With its threshold at 0 V the comparator of positive current reached its fault input.
        positive_tripped: bool,
        /// With its threshold back it is quiet.
        positive_quiet: bool,
        /// The same for negative current.
        negative_tripped: bool,
        /// The same for negative current.
        negative_quiet: bool,
    }
    /// The clocks, counted against each other.
    0x90 Answer Clocks {
        /// Nominal frequency of the main clock, in hertz.
        main_hz: u32,
        /// Periods of the low-speed oscillator that were counted; 0 where it stands still.
        lsi_periods: u32,
        /// Main clock's cycles meanwhile.
        lsi_main_cycles: u32,
        /// Milliseconds that a USB host's frames counted; 0 without one. The only clock here that is a crystal's.
        usb_frames: u16,
        /// Main clock's cycles meanwhile.
        usb_main_cycles: u32,
        /// Excess periods of the 48 MHz oscillator in the USB host's last frame, of 48 000; 0 without one.
        hsi48_off: i16,
        /// Its trim, 0 to 127, which follows a USB host.
        hsi48_trim: u8,
    }
    /// Result of a test of the link.
    0x91 Answer LinkTested {
        /// `LinkData` received since the last `TestLink`.
        frames: u32,
        /// Bytes of their data.
        bytes: u32,
        /// Frames with data that is not that of their number.
        bad: u32,
        /// Frames missing from their sequence.
        lost: u32,
    }
    /// Log of the firmware.
    0x92 Event Log<'a> {
        /// Bytes sent in `Log`s before this one, since boot: a gap was lost on the way.
        seq: u32,
        /// Log frames of the firmware that found no room, since boot.
        dropped: u32,
        /// Whole log frames of defmt as they leave over RTT: rzCOBS, each ends with 0. The image's own table decodes them.
        #[serde(borrow)]
        data: Raw<'a>,
    }
    /// The device has no such window any more, or no such piece of it: answers `ResendWindow`.
    0x93 Event WindowGone {
        /// Window.
        seq: u32,
    }
}

/// Returns `true` if a frame of this id begins with a request's number: any that is not known does, as it may be a newer request.
pub const fn is_numbered(id: u8) -> bool {
    match part_of(id) {
        Some(part) => part.is_numbered(),
        None => true,
    }
}

/// Returns `true` if a frame of this id comes from a host and asks for an answer: one that is not known does, as it may be a newer request.
pub const fn is_request(id: u8) -> bool {
    matches!(part_of(id), Some(Part::Request) | None)
}

impl WindowStart {
    /// Scales of its codes.
    pub fn scales(&self) -> Scales {
        Scales {
            v_full_scale_mv: self.v_full_scale_mv,
            i_full_scale_ma: self.i_full_scale_ma,
        }
    }
}

impl FrontEnd {
    /// Scales of the codes of coil voltage and current.
    pub fn scales(&self) -> Scales {
        Scales {
            v_full_scale_mv: self.v_full_scale_mv,
            i_full_scale_ma: self.i_full_scale_ma,
        }
    }
}

impl Configure {
    /// Settings of a device at start: a minute, and a frequency that stays.
    pub const DEFAULT: Self = Self {
        give_up_s: 60,
        dither_permille: 0,
    };

    /// Accepted values of [`Configure::give_up_s`].
    pub const GIVE_UP_S: RangeInclusive<u16> = 60..=600;

    /// Accepted values of [`Configure::dither_permille`].
    pub const DITHER_PERMILLE: RangeInclusive<u8> = 0..=10;

    /// Checks that every setting is within its range.
    ///
    /// # Errors
    /// The place of the first field that is not, for [`Outcome::OutOfRange`].
    pub fn check(&self) -> Result<(), u32> {
        if !Self::GIVE_UP_S.contains(&self.give_up_s) {
            return Err(0);
        }
        if !Self::DITHER_PERMILLE.contains(&self.dither_permille) {
            return Err(1);
        }
        Ok(())
    }
}

/// Value of a temperature of [`Status`] if no sensor is fitted.
pub const NO_SENSOR_C: i16 = -300;

/// Value of [`Status::panel_level`] while the panel's setting is not in force.
pub const NO_PANEL: u8 = u8::MAX;

/// Hash of the whole table: names, ids, fields, types and enumeration numbers. Not the faults: they
/// are open ([`crate::fault`]).
pub const SCHEMA_HASH: u64 = {
    let mut hash = FNV_BASIS;
    let mut k = 0;
    while k < MESSAGES.len() {
        hash = fold_entry(hash, &MESSAGES[k]);
        k += 1;
    }
    let mut k = 0;
    while k < ENUMS.len() {
        hash = fold_entry(hash, &ENUMS[k]);
        k += 1;
    }
    hash
};
