//! Which burn backend computes the RL-MLP.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::PinnError;

/// The burn backend on which the RL-MLP and its Jacobian are computed. Both give the same digits
/// to rounding; they differ in time only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// burn-flex: burn's own CPU backend, and the faster one here.
    #[default]
    Flex,
    /// burn-ndarray: deprecated upstream since 0.22, kept because the project's owner named it.
    Ndarray,
}

impl Backend {
    /// All backends, in the order in which they are offered to a user.
    pub const ALL: [Self; 2] = [Self::Flex, Self::Ndarray];

    /// The burn device that stands for this backend, without autodiff.
    pub(crate) fn device(self) -> Device {
        match self {
            Self::Flex => Device::flex(),
            // Wanted although burn deprecates it: see the variant.
            #[allow(deprecated)]
            Self::Ndarray => Device::ndarray(),
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flex => "flex",
            Self::Ndarray => "ndarray",
        })
    }
}

impl FromStr for Backend {
    type Err = PinnError;

    /// Reads `flex` or `ndarray`.
    ///
    /// # Errors
    /// [`PinnError::UnknownName`] for anything else.
    fn from_str(name: &str) -> Result<Self, PinnError> {
        Self::ALL
            .into_iter()
            .find(|backend| backend.to_string() == name)
            .ok_or_else(|| PinnError::UnknownName {
                what: "backend",
                name: name.to_owned(),
                known: "flex, ndarray",
            })
    }
}
