//! Enumerations of the messages; their numbers are on the wire.

use super::schema::{Entry, wire_enum};

wire_enum! {
    /// State of the controller.
    pub enum State {
        /// Inverter off, waiting for a power request.
        Idle = 0,
        /// Pot probe: a part of a half-cycle at the highest frequency, to see what stands on the coil.
        Probing = 1,
        /// Regulating power.
        Heating = 2,
        /// Inverter off for good: its tries are used up, or the controller itself is faulty. A person
        /// switches off and on.
        LockedOut = 3,
        /// No suitable pot; probes for one from time to time.
        WaitingForPot = 4,
        /// Inverter off after a trip, or without good mains; starts again by itself.
        Pausing = 5,
    }
}

wire_enum! {
    /// Limit that holds the power below the request.
    pub enum Limit {
        /// Nothing: it is the request, or the inverter is off.
        None = 0,
        /// An end of the frequency range.
        Frequency = 1,
        /// The coil current's crest.
        Current = 2,
        /// The coil voltage's crest.
        CoilVoltage = 3,
        /// Nearness of the tank's resonance.
        Resonance = 4,
        /// The current that is left at a turn-off, which has to turn the bridge's node over.
        SoftSwitching = 5,
        /// A pot too small for more.
        SmallPot = 6,
        /// A temperature.
        Temperature = 7,
        /// Mains too low.
        Mains = 8,
        /// The panel's level.
        Panel = 9,
        /// The boost is over: the level below it.
        Boost = 10,
        /// The temperature that the panel is set to keep warm.
        KeepWarm = 11,
        /// The other zone of a shared supply.
        SharedSupply = 12,
        /// The bus voltage, where C2 is small.
        BusVoltage = 13,
    }
}

wire_enum! {
    /// Reason for which the hob has switched itself off, until power is requested again or its panel is touched.
    pub enum OffReason {
        /// It has not.
        None = 0,
        /// No pot that can be heated, for as long as it waits.
        NoPot = 1,
        /// Nobody has touched the panel for as long as the level allows. Only a touch switches on again.
        Unattended = 2,
        /// The timer ended. Only a touch of the panel switches on again.
        Timer = 3,
    }
}

wire_enum! {
    /// Pot on the coil.
    pub enum Pot {
        /// Not judged yet.
        Unknown = 0,
        /// Nothing.
        Absent = 1,
        /// A ferromagnetic pot that can be heated.
        Ferromagnetic = 2,
        /// A ferromagnetic pot much smaller than the coil, or far off its centre.
        Small = 3,
        /// A non-ferromagnetic load (aluminium, copper, austenitic stainless).
        Unsuitable = 4,
    }
}

wire_enum! {
    /// Answer to a command.
    pub enum Outcome {
        /// Done. To `SetPower`, `detail` is the requested power as the device took it, in watt: at most its rating.
        Ok = 0,
        /// The payload is not a message of that id, or has no number.
        Malformed = 1,
        /// No message of that id, or one that only a device sends.
        UnknownMessage = 2,
        /// No compatible `Hello` has been exchanged.
        NotPaired = 3,
        /// Asked power that no hob gives; `detail` is the largest that may be asked, in watt.
        PowerOutOfRange = 4,
        /// A fault is active; clear it first. `detail` is its number; 0 when it is replay mode that
        /// locks the power outputs.
        FaultActive = 5,
        /// Lookup of the wrong length; `detail` is the length expected.
        LookupLength = 6,
        /// Lookup does not begin with its magic or is of an unknown format.
        LookupFormat = 7,
        /// Lookup fails its CRC-32.
        LookupCrc = 8,
        /// Lookup not newer than the active one; `detail` is the active version.
        LookupStale = 9,
        /// A lookup cell is outside the plausible range; `detail` is the cell's index.
        LookupRange = 10,
        /// Neighbouring lookup cells differ too much; `detail` is the cell's index.
        LookupSlope = 11,
        /// R or L runs the wrong way with frequency or current; `detail` is the cell's index.
        LookupNotMonotone = 12,
        /// A lookup is already waiting for its half-cycle boundary; try again.
        Busy = 13,
        /// The inverter is off until a person switches off and on; `detail` is the fault's number.
        LockedOut = 14,
        /// Lookup too many versions ahead of the active one; `detail` is the highest accepted.
        LookupStep = 15,
        /// Switched off at the panel, by its timer, or because nobody touched it for too long: only a person switches on again.
        PanelOff = 16,
        /// A setting outside its range, and none was changed; `detail` is the field's place in its
        /// message, from 0.
        OutOfRange = 17,
        /// The inverter must be off for this: power is requested, or flows.
        NotIdle = 18,
        /// This device has not what it takes: a simulated hob has no ROM bootloader, no comparators and no log.
        Unavailable = 19,
        /// The device is not in replay mode.
        NotReplaying = 20,
    }
}

wire_enum! {
    /// A piece of a window, as it travels in one message.
    pub enum Piece {
        /// Its `WindowStart`.
        Start = 0,
        /// A `WindowChunk`.
        Pairs = 1,
        /// A `TrajectoryChunk`.
        Trajectory = 2,
        /// Its `WindowEnd`.
        End = 3,
        /// None: the host has the window, or has given it up.
        Nothing = 4,
    }
}

wire_enum! {
    /// Program after a `Restart`.
    pub enum Program {
        /// The firmware, from its beginning.
        Firmware = 0,
        /// The chip's ROM bootloader, which takes another firmware over USB (DFU) or the serial port. It stays until
        /// the next reset.
        Bootloader = 1,
    }
}

impl OffReason {
    /// Returns the reason in plain English; empty for [`OffReason::None`].
    pub const fn text(self) -> &'static str {
        match self {
            Self::None => "",
            Self::NoPot => "it switched itself off: no pot was put on",
            Self::Timer => "its timer switched it off; only the panel switches it on again",
            Self::Unattended => {
                "it switched itself off: nobody touched its panel for as long as the level allows; only the panel switches it on again"
            }
        }
    }
}

/// Every enumeration that messages use.
pub const ENUMS: &[Entry] = &[
    State::ENTRY,
    Limit::ENTRY,
    OffReason::ENTRY,
    Pot::ENTRY,
    Outcome::ENTRY,
    Piece::ENTRY,
    Program::ENTRY,
];
