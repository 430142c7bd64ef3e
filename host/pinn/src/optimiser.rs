//! Result of the optimisers of the RL-MLP.

use crate::parameters::Parameters;
use crate::progress::StopReason;

/// Result of an optimiser.
pub(crate) struct Descent {
    pub parameters: Parameters,
    /// |e|² at these parameters.
    pub squares: f64,
    pub stopped: StopReason,
}
