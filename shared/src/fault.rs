//! Numbered faults. A number, once given, keeps its meaning for ever.

use crate::wire::schema::wire_enum;

wire_enum! {
    /// Why the controller is in its safe state. The number is what a service manual quotes.
    pub enum Fault {
        /// No fault.
        None = 0,
        /// No pot on the coil when heating was asked for.
        NoPot = 1,
        /// A load that induction cannot heat at its rating (aluminium, copper, bare stainless).
        UnsuitablePot = 2,
        /// The pot was taken away while heating.
        PotRemoved = 3,
        /// Coil current reached the trip level.
        OverCurrent = 4,
        /// Bus voltage above its limit.
        BusOverVoltage = 5,
        /// Sample blocks were lost (DMA overrun, trigger stopped).
        SamplesLost = 6,
        /// Too many samples at the end of the ADC's range.
        SensorSaturated = 7,
        /// The inverter was about to run at or below resonance.
        BelowResonance = 8,
        /// The R, L estimate left its plausible range.
        EstimatorDiverged = 9,
        /// No mains zero crossing for longer than three half-cycles.
        MainsLost = 10,
    }
}

impl Fault {
    /// The fault's number.
    pub fn number(self) -> u16 {
        self as u16
    }
}
