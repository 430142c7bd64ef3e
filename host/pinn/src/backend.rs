//! Backends that compute the networks: own code, or burn.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::PinnError;

/// Backend that computes the networks and their gradients. All give the same digits up to rounding and differ
/// in time only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// This crate's own kernels, without burn: the fastest on a CPU.
    #[default]
    Fused,
    /// burn-ndarray: deprecated upstream since 0.22, kept as a requirement of the project.
    Ndarray,
    /// burn on a GPU through WebGPU, Vulkan or Metal; single precision, so not for `hybrid`.
    #[cfg(feature = "wgpu")]
    Wgpu,
}

impl Backend {
    /// All backends of this build, in the order of help texts.
    pub const ALL: &[Self] = &[
        Self::Fused,
        Self::Ndarray,
        #[cfg(feature = "wgpu")]
        Self::Wgpu,
    ];

    /// Device of burn for this backend, without autodiff; `None` for the own kernels.
    ///
    /// # Errors
    /// [`PinnError::Backend`] if this machine has no such device.
    pub(crate) fn device(self) -> Result<Option<Device>, PinnError> {
        match self {
            Self::Fused => Ok(None),
            // Required although burn deprecates it: see the variant.
            #[allow(deprecated)]
            Self::Ndarray => Ok(Some(Device::ndarray())),
            #[cfg(feature = "wgpu")]
            Self::Wgpu => gpu().map(Some),
        }
    }

    /// Returns `true` if it computes in double precision, which `hybrid` needs.
    pub(crate) fn is_double(self) -> bool {
        matches!(self, Self::Fused | Self::Ndarray)
    }
}

/// The GPU, opened once a process.
#[cfg(feature = "wgpu")]
fn gpu() -> Result<Device, PinnError> {
    use std::sync::OnceLock;
    static GPU: OnceLock<Result<Device, String>> = OnceLock::new();
    let opened = GPU.get_or_init(|| Device::wgpu_options().init().map_err(|e| e.to_string()));
    opened.clone().map_err(|detail| PinnError::Backend {
        backend: Backend::Wgpu.to_string(),
        detail,
    })
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fused => "fused",
            Self::Ndarray => "ndarray",
            #[cfg(feature = "wgpu")]
            Self::Wgpu => "wgpu",
        })
    }
}

impl FromStr for Backend {
    type Err = PinnError;

    /// Reads the name of one of [`Self::ALL`].
    ///
    /// # Errors
    /// [`PinnError::UnknownName`] for anything else.
    fn from_str(name: &str) -> Result<Self, PinnError> {
        let mut all = Self::ALL.iter();
        all.find(|backend| backend.to_string() == name)
            .copied()
            .ok_or_else(|| PinnError::UnknownName {
                what: "backend",
                name: name.to_owned(),
                known: "fused, ndarray (wgpu in builds with this feature)".to_owned(),
            })
    }
}
