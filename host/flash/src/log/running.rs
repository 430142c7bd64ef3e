//! Which image runs on a board: what decides by which table its log is read.

use crate::image::{BuildId, Image};

/// What a board says of its program.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Running {
    /// Package and version, fit to be shown; empty where that was not to be had.
    pub build: String,
    /// Its build id; none on a simulated hob.
    pub build_id: Option<BuildId>,
    /// CRC-32 of its flash, where it told.
    pub crc: Option<u32>,
}

impl Running {
    /// Whether this is the image that runs: by the build id, else by the CRC. What tells neither runs no image.
    pub fn is(&self, image: &Image) -> bool {
        match (self.build_id, self.crc) {
            (Some(id), _) => id == image.build_id,
            (None, Some(crc)) => crc == image.crc,
            (None, None) => false,
        }
    }

    /// In words: `ihd-firmware 0.1.0 (build 1f2e3d4c)`.
    pub fn describe(&self) -> String {
        let build = match self.build.as_str() {
            "" => "a firmware",
            build => build,
        };
        match (self.build_id, self.crc) {
            (Some(id), _) => format!("{build} (build {})", id.short()),
            (None, Some(crc)) => format!("{build} (CRC {crc:08x})"),
            (None, None) => format!("{build} without build id"),
        }
    }
}
