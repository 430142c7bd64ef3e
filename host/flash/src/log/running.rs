//! Identity of the program that runs on a board, which selects the table of its log.

use crate::image::{BuildId, Image};

/// Identity of a running program.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunningProgram {
    /// Package and version, printable; empty if unknown.
    pub build: String,
    /// Build id; `None` on a simulated hob.
    pub build_id: Option<BuildId>,
    /// CRC-32 of its flash; `None` if not reported.
    pub crc: Option<u32>,
}

impl RunningProgram {
    /// Returns `true` if this image runs: by the build id, else by the CRC; `false` if neither is known.
    pub fn is(&self, image: &Image) -> bool {
        match (self.build_id, self.crc) {
            (Some(id), _) => id == image.build_id,
            (None, Some(crc)) => crc == image.crc,
            (None, None) => false,
        }
    }

    /// Description: `ihd-firmware 0.1.0 (build 1f2e3d4c)`.
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
