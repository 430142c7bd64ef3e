//! Serialised state of [`Learning`]: JSON, every number exact.

use ihd_map::{PotMap, PotMapState};
use ihd_pinn::{Parameters, PinnConfig};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::blob::BlobError;
use serde::{Deserialize, Serialize};

use super::Learning;
use super::lag::Lag;
use super::lookup_builder::LookupBuilder;
use super::sensors::Sensors;
use super::version::Versions;

/// Format number of [`Saved`].
const FORMAT: u32 = 3;

/// Oldest format that is read. Format 1 has no sensors; format 2 has load curves without deviations, which the map does not use.
const MIN_FORMAT: u32 = 1;

/// Reason for which bytes are not a state of [`Learning`].
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// Not JSON of this layout.
    #[error("what was learned cannot be read: {0}")]
    Json(#[from] serde_json::Error),
    /// Written by a later build.
    #[error("what was learned is of format {0}, this build reads format {FORMAT}")]
    Format(u32),
    /// The stored lookup does not pass the checks.
    #[error("the lookup that was learned is damaged: {0}")]
    Lookup(#[from] BlobError),
    /// Impossible numbers of the sensors.
    #[error("what was learned of the sensors is damaged")]
    Sensors,
    /// Impossible load curves or lag.
    #[error("what was learned holds a curve that is no load's")]
    Curves,
}

#[derive(Serialize, Deserialize)]
struct Saved {
    format: u32,
    versions: Versions,
    refusals: u32,
    silence: u32,
    offered: Option<Vec<u8>>,
    warm: Option<Parameters>,
    #[serde(default)]
    map: PotMapState,
    #[serde(default)]
    lag: Lag,
    #[serde(default)]
    sensors: Sensors,
    #[serde(default)]
    boot: Option<u32>,
}

impl Learning {
    /// Serialises the state; the network's settings are not part of it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let saved = Saved {
            format: FORMAT,
            versions: self.builder.versions,
            refusals: self.builder.refusals,
            silence: self.builder.silence,
            offered: self.builder.offered.as_ref().map(|l| l.to_bytes().to_vec()),
            warm: self.warm.clone(),
            map: self.map.state(),
            lag: self.lag,
            sensors: self.sensors,
            boot: self.boot,
        };
        // Cannot fail: maps have text as keys, and the rest are numbers.
        serde_json::to_vec(&saved).unwrap_or_default()
    }

    /// Restores the state that [`Learning::to_bytes`] wrote. Start parameters that do not fit the network's settings any more are left out.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are damaged; nothing of them is used.
    pub fn from_bytes(bytes: &[u8], network: PinnConfig) -> Result<Self, StateError> {
        #[derive(Deserialize)]
        struct Format {
            format: u32,
        }
        let Format { format } = serde_json::from_slice(bytes)?;
        if !(MIN_FORMAT..=FORMAT).contains(&format) {
            return Err(StateError::Format(format));
        }
        let saved: Saved = serde_json::from_slice(bytes)?;
        let offered = saved
            .offered
            .map(|b| RlLookup::from_bytes(&b))
            .transpose()?;
        Ok(Self {
            warm: saved.warm.filter(|start| fits(start, &network)),
            map: PotMap::from_state(saved.map).ok_or(StateError::Curves)?,
            lag: Some(saved.lag)
                .filter(Lag::is_sound)
                .ok_or(StateError::Curves)?,
            sensors: Some(saved.sensors)
                .filter(Sensors::is_sound)
                .ok_or(StateError::Sensors)?,
            builder: LookupBuilder {
                offered,
                versions: saved.versions,
                refusals: saved.refusals,
                silence: saved.silence,
            },
            boot: saved.boot,
            ..Self::new(network)
        })
    }
}

fn fits(start: &Parameters, network: &PinnConfig) -> bool {
    let config = PinnConfig {
        start: Some(start.clone()),
        ..network.clone()
    };
    config.validate().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lies_are_refused_and_named() {
        let config = PinnConfig::default;
        let good = Learning::new(config()).to_bytes();
        assert!(Learning::from_bytes(&good, config()).is_ok());
        let text = String::from_utf8(good).unwrap();
        for (from, to, says) in [
            ("{", "", "cannot be read"),
            ("\"format\":3", "\"format\":4", "format 4"),
            (
                "\"curves\":[]",
                "\"curves\":[{\"f_sw_hz\":0,\"t_s\":0,\"windows\":1,\"bins\":[]}]",
                "no load",
            ),
            ("\"offered\":null", "\"offered\":[1,2,3]", "damaged"),
            ("\"silence\":0", "\"silence\":-1", "cannot be read"),
        ] {
            let lie = text.replacen(from, to, 1);
            assert_ne!(lie, text);
            let why = Learning::from_bytes(lie.as_bytes(), config()).unwrap_err();
            assert!(why.to_string().contains(says), "{why}");
        }
    }

    /// State written by a build before the sensors.
    #[test]
    fn the_first_format_is_read_and_knows_nothing_of_the_sensors() {
        let text = String::from_utf8(Learning::new(PinnConfig::default()).to_bytes()).unwrap();
        let (before, _) = text.split_once(",\"sensors\"").unwrap();
        let old = before.replacen("\"format\":3", "\"format\":1", 1) + "}";
        let restored = Learning::from_bytes(old.as_bytes(), PinnConfig::default()).unwrap();
        assert_eq!(*restored.sensors(), Sensors::default());
    }

    #[test]
    fn a_start_that_does_not_fit_the_network_is_left_out() {
        let mut learning = Learning::new(PinnConfig::default());
        learning.warm = Some(Parameters {
            embedding: PinnConfig::default().embedding,
            f_mains_hz: 50.0,
            r_scale_ohm: 4.0,
            l_scale_h: 3e-5,
            layers: Vec::new(),
            vi_layers: Vec::new(),
            inputs: None,
        });
        let restored = Learning::from_bytes(&learning.to_bytes(), PinnConfig::default()).unwrap();
        assert!(restored.warm.is_none());
    }
}
