//! Captures of a half-bridge hob with known truth and known faults. Nothing of ihd is used here.
//!
//! ```text
//! kind, seed ─► plan (load, bridge, neighbours, sensors) ─► circuit: Runge-Kutta ─► sensors: noise, codes, faults ─► MadeCapture
//! ```

mod circuit;
mod kind;
mod sensors;

pub use circuit::{Bridge, Circuit, LoadLaw, Neighbour, Truth};
pub use kind::{Kind, Plan};
pub use sensors::{Recorded, Sensors, Times};

/// Capture with its truth.
#[derive(Clone, Debug)]
pub struct MadeCapture {
    /// Kind of disturbance.
    pub kind: Kind,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Samples and truth.
    pub recorded: Recorded,
}

/// Makes a capture.
pub fn make(kind: Kind, seed: u64) -> MadeCapture {
    MadeCapture {
        kind,
        seed,
        recorded: Plan::draw(kind, seed).record(seed),
    }
}
