//! Widths of the law's normal processes.

use super::LEVEL;
use super::prior::Process;
use crate::parameters::OUTPUTS;

/// Widths relative to R₀ and L₀, and the length on the law's axis over which R and L change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Widths {
    /// Widths of R(I) and L(I).
    pub law: [f64; OUTPUTS],
    /// Widths of half the difference between the flanks.
    pub flanks: [f64; OUTPUTS],
    /// Length on the axis ln(1 + I/4 A).
    pub length: f64,
}

impl Widths {
    /// Widths of the greatest evidence over the simulated loads of `recipe.rs`, whose test finds them:
    /// `cargo test --release -p ihd-pinn widths_are_learned -- --ignored --nocapture`.
    pub const LEARNED: Self = Self {
        law: [0.402, 0.111],
        flanks: [0.007, 0.002],
        length: 1.059,
    };

    /// Processes of law and flanks, of R and of L.
    pub(super) fn processes(&self) -> [(Process, Process); OUTPUTS] {
        std::array::from_fn(|o| {
            let process = |width, level| Process {
                width,
                length: self.length,
                level,
            };
            (process(self.law[o], LEVEL), process(self.flanks[o], 0.0))
        })
    }
}
