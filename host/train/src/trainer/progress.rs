//! Progress of a training run.

use ihd_link::GrantedPower;
use ihd_shared::wire::messages::Telemetry;

use super::OperatingPoint;

/// Progress of a training run, as passed to the caller.
#[derive(Clone, Copy, Debug)]
pub enum RunProgress<'a> {
    /// A half-cycle of an operating point that is not settled yet.
    Settling {
        /// Requested power in watt.
        asked_w: u16,
        /// Telemetry of the half-cycle.
        telemetry: &'a Telemetry,
    },
    /// The device took less than was requested.
    Reduced(GrantedPower),
    /// The device does not heat and will again by itself: it waits for a pot, or pauses after a trip or for the mains. Reported once each
    /// time.
    Waiting {
        /// Requested power in watt.
        asked_w: u16,
        /// Telemetry of the half-cycle in which it began.
        telemetry: &'a Telemetry,
    },
    /// Settled; a window is on its way.
    AwaitingWindow {
        /// Operating point.
        point: OperatingPoint,
    },
    /// The network trains.
    Training {
        /// Number of the window.
        seq: u32,
        /// The optimiser's state.
        step: &'a ihd_pinn::TrainingProgress,
    },
    /// A window was not used.
    Rejected {
        /// Number of the window.
        seq: u32,
        /// Reason.
        why: &'a str,
    },
    /// A lookup is active on the device.
    LookupActive {
        /// Its version.
        version: u32,
        /// Cells that rest on observations.
        observed_cells: u32,
    },
    /// Message for the user that does not end the run.
    Note {
        /// Text of the message.
        text: &'a str,
    },
}
