//! States of the controller.

use ihd_shared::wire::messages::State;

use crate::control::heating::Heating;
use crate::control::waiting::Waiting;

/// State, and what it alone needs.
#[derive(Clone, Debug)]
pub(super) enum ControlState {
    /// Off, or about to start.
    Idle,
    /// The first probe for a pot is under way.
    Probing {
        /// Start of the time in which the bridge may switch without a judged pot, in milliseconds.
        unjudged_since_ms: u32,
    },
    /// A pot is heated.
    Heating(Heating),
    /// Probes at intervals.
    WaitingForPot(Waiting),
    /// A fault is active, and its pause not over.
    Pausing,
    /// Off until a person switches off and on.
    LockedOut,
}

impl ControlState {
    /// The state as telemetry names it.
    pub(super) fn wire(&self) -> State {
        match self {
            Self::Idle => State::Idle,
            Self::Probing { .. } => State::Probing,
            Self::Heating(_) => State::Heating,
            Self::WaitingForPot(_) => State::WaitingForPot,
            Self::Pausing => State::Pausing,
            Self::LockedOut => State::LockedOut,
        }
    }

    /// Time at which a pot was judged last, or the bridge began to probe for one.
    pub(super) fn unjudged_since_ms(&mut self) -> Option<&mut u32> {
        match self {
            Self::Probing { unjudged_since_ms } => Some(unjudged_since_ms),
            Self::Heating(heating) => Some(heating.unjudged_since_ms()),
            Self::WaitingForPot(waiting) => Some(waiting.unjudged_since_ms()),
            Self::Idle | Self::Pausing | Self::LockedOut => None,
        }
    }
}
