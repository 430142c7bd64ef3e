//! Responses to a host, as they wait for the link, and events as urgent.

use ihd_shared::sampling::{CODE_BITS, I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::wire::messages::{
    Channels, Clocks, Comparators, FaultEvent, FrontEnd, LinkTested, Outcome, ReplayMode, Reply,
    ResendWindow, Status, Utilisation,
};

use crate::link::replay::ReplayedEstimates;
use crate::sense::bus::BUS_FULL_SCALE_DV;
use crate::sense::mains::MAINS_FULL_SCALE_MV;

/// A response that waits, or an event as urgent.
#[derive(Clone)]
pub enum Response {
    /// The device's hello.
    Hello,
    /// Scales of the channels' codes.
    FrontEnd,
    /// Outcome of a command.
    Reply(Reply),
    /// The status at the request.
    Status(Status),
    /// Load of the controller.
    Utilisation(Utilisation),
    /// The lookup that is active when the answer leaves.
    Lookup,
    /// A fault tripped or was cleared.
    Fault(FaultEvent),
    /// Replay mode was entered, left, or is missing.
    ReplayMode(ReplayMode),
    /// Estimates from replayed blocks.
    ReplayEstimates(ReplayedEstimates),
    /// A piece of a window once more.
    Piece(ResendWindow),
    /// Identity of the device.
    Board,
    /// Means and deviations of the measuring channels.
    Channels(Channels),
    /// Outcome of a test of the trip in hardware.
    Comparators(Comparators),
    /// The clocks against each other.
    Clocks(Clocks),
    /// Outcome of a test of the link.
    LinkTested(LinkTested),
}

impl Response {
    /// An outcome that has no detail.
    pub const fn outcome(outcome: Outcome) -> Self {
        Self::reply(outcome, 0)
    }

    /// An outcome with its detail.
    pub const fn reply(outcome: Outcome, detail: u32) -> Self {
        Self::Reply(Reply { outcome, detail })
    }
}

impl From<(Outcome, u32)> for Response {
    /// An outcome with its detail.
    fn from((outcome, detail): (Outcome, u32)) -> Self {
        Self::reply(outcome, detail)
    }
}

/// Scales of the codes of this firmware's channels.
pub fn front_end() -> FrontEnd {
    FrontEnd {
        v_full_scale_mv: V_FULL_SCALE_MV,
        i_full_scale_ma: I_FULL_SCALE_MA,
        bus_full_scale_mv: BUS_FULL_SCALE_DV * 100,
        mains_full_scale_mv: MAINS_FULL_SCALE_MV,
        bits: CODE_BITS,
    }
}
