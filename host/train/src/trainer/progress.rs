//! What the trainer is doing, for whoever watches.

use ihd_shared::wire::messages::Telemetry;

use super::OperatingPoint;

/// What the trainer is doing, for whoever watches.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// A half-cycle of an operating point that is not settled yet.
    Settling {
        /// Power asked for, in watt.
        asked_w: u16,
        /// The half-cycle.
        telemetry: &'a Telemetry,
    },
    /// The device does not heat now and will by itself: it waits for a pot, or pauses after a trip or for
    /// the mains. Reported once each time.
    Waiting {
        /// Power asked for, in watt.
        asked_w: u16,
        /// The half-cycle in which it began.
        telemetry: &'a Telemetry,
    },
    /// Settled; a window is on its way.
    AwaitingWindow {
        /// Where.
        point: OperatingPoint,
    },
    /// The network trains.
    Training {
        /// Window.
        seq: u32,
        /// The optimiser's state.
        step: &'a ihd_pinn::Progress,
    },
    /// A window was not used.
    Rejected {
        /// Window.
        seq: u32,
        /// Why.
        why: &'a str,
    },
    /// A lookup is active on the device.
    LookupActive {
        /// Its version.
        version: u32,
        /// Cells that rest on observations.
        observed_cells: u32,
    },
    /// Something that a person wants to know and that ends nothing.
    Note {
        /// What.
        text: &'a str,
    },
}
