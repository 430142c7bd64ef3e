//! Interface to the sampling path: its status, and the actions that control answers with.

use ihd_shared::fault::Fault;

use crate::drive::bridge::Drive;
use crate::drive::sequencer::PotProbe;
use crate::sampling::path::SamplingPath;
use crate::sense::product_sums::PairArithmetic;

/// Change that control requests of the sampling path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing changes.
    Keep,
    /// Request this drive.
    Drive(Drive),
    /// Probe for a pot from the next zero crossing.
    ProbePot(PotProbe),
    /// Open both switches at the next zero crossing.
    OffAtCrossing,
    /// Enter the safe state.
    Fault(Fault),
    /// Leave the safe state.
    ClearFault,
}

/// Status of the sampling path between two blocks.
#[derive(Clone, Copy, Debug)]
pub struct SamplingStatus {
    /// Time since boot, in milliseconds.
    pub now_ms: u32,
    /// The active fault.
    pub fault: Fault,
    /// The requested drive.
    pub requested: Drive,
    /// The bridge switches.
    pub switching: bool,
    /// Samples come from a host.
    pub replaying: bool,
}

impl SamplingStatus {
    /// Reads it from the sampling path.
    pub fn read(path: &SamplingPath<impl PairArithmetic>) -> Self {
        Self {
            now_ms: path.now_ms(),
            fault: path.fault(),
            requested: path.requested_drive(),
            switching: path.drive().is_switching(),
            replaying: path.is_replaying(),
        }
    }
}
