//! Lookups from the map: when one is due, under which version, and what the device said to those before.

use ihd_map::{Cells, CurrentCurve};
use ihd_shared::lookup::RlLookup;

use super::LookupUpdate;
use super::significance;
use super::version::Versions;
use crate::lookup::BuiltLookup;

/// Longest pause between two offered lookups, in windows, after consecutive refusals by the device: some three minutes at five windows a
/// second.
const MAX_SILENCE_WINDOWS: u32 = 1_024;

/// Builder of a device's lookups.
#[derive(Clone, Debug, Default)]
pub struct LookupBuilder {
    /// Lookup that was built last, with which the next window is compared.
    pub offered: Option<RlLookup>,
    /// Version numbers in use.
    pub versions: Versions,
    /// Lookups that the device refused in a row.
    pub refusals: u32,
    /// Windows to learn before the next lookup is offered.
    pub silence: u32,
}

impl LookupBuilder {
    /// Processes the version that the device uses. An offered lookup of another version is dropped.
    pub fn set_device_version(&mut self, version: u32) {
        if self.offered.as_ref().is_some_and(|l| l.version != version) {
            self.offered = None;
        }
        self.accepted(version);
    }

    /// Processes the device's acceptance of an offered lookup.
    pub fn accepted(&mut self, version: u32) {
        self.versions.device = version;
        self.refusals = 0;
        self.silence = 0;
    }

    /// Processes the device's refusal of an offered lookup. The next one is offered after a pause that doubles with every refusal in a
    /// row.
    pub fn refused(&mut self, version: u32) {
        if self.offered.as_ref().is_some_and(|l| l.version == version) {
            self.offered = None;
        }
        self.refusals = self.refusals.saturating_add(1);
        let pause = 1u32
            .checked_shl(self.refusals)
            .unwrap_or(MAX_SILENCE_WINDOWS);
        self.silence = pause.min(MAX_SILENCE_WINDOWS);
    }

    /// Forgets everything but the versions, so that no two lookups of a device have the same number.
    #[must_use]
    pub fn forgotten(&self) -> Self {
        Self {
            versions: self.versions,
            ..Self::default()
        }
    }

    /// Returns `true` if the lookup that was built last does not describe a new curve, or none was built.
    pub fn is_outdated_by(&self, curve: &CurrentCurve) -> bool {
        let offered = self.offered.as_ref();
        offered.is_none_or(|lookup| significance::curve_changed(curve, lookup))
    }

    /// Counts a learned window. Returns `true` while the pause after a refusal lasts.
    pub fn pauses(&mut self) -> bool {
        self.silence = self.silence.saturating_sub(1);
        self.silence > 0
    }

    /// Builds the next lookup from the map's cells; `None` are those of an empty map. `force` builds one that says the same as the last.
    pub fn build(&mut self, cells: Option<Cells>, force: bool) -> LookupUpdate {
        let Some(cells) = cells else {
            return LookupUpdate::Refused("the window shows no load".to_owned());
        };
        let Some(version) = self.versions.next() else {
            return LookupUpdate::Refused(format!(
                "the device's lookup has version {}, the highest that there is; reset it",
                self.versions.device
            ));
        };
        let built = match BuiltLookup::from_cells(cells, version) {
            Ok(built) => built,
            Err(why) => return LookupUpdate::Refused(why.to_string()),
        };
        let known = self.offered.as_ref();
        if !force
            && known.is_some_and(|offered| !significance::cells_changed(&built.lookup, offered))
        {
            return LookupUpdate::Unchanged;
        }
        self.versions.offered = version;
        self.offered = Some(built.lookup.clone());
        LookupUpdate::New(Box::new(built))
    }
}
