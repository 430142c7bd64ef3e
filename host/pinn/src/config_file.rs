//! TOML files of a [`PinnConfig`], on top of a preset.

use std::fmt;

use crate::{Backend, Optimiser, PinnConfig, PinnError, Preset, PresetLibrary};

impl PinnConfig {
    /// Reads a TOML file: settings by name, on top of the preset that its key `preset` names (`hybrid` if not given).
    /// A `description` is for the reader.
    ///
    /// # Errors
    /// [`PinnError::File`] with the parser's message, [`PinnError::UnknownName`], or an error of
    /// [`Self::validate`].
    pub fn from_toml(text: &str) -> Result<Self, PinnError> {
        Self::from_described_toml(text).map(|(config, _)| config)
    }

    /// Reads a TOML file and its description.
    pub(crate) fn from_described_toml(text: &str) -> Result<(Self, Option<String>), PinnError> {
        let refused = |e: &dyn fmt::Display| PinnError::File {
            detail: e.to_string(),
        };
        let mut given: toml::Table = text.parse().map_err(|e: toml::de::Error| refused(&e))?;
        let mut text_of = |key: &str| match given.remove(key) {
            None => Ok(None),
            Some(toml::Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(refused(&format!("{key} is {other}, not a text"))),
        };
        let (preset, description) = (text_of("preset")?, text_of("description")?);
        let preset = preset.as_deref().unwrap_or(Preset::default().name());
        let base = PresetLibrary::default().get(preset)?.config;
        // Checked first, because these errors list the valid names.
        if let Some(toml::Value::String(name)) = given.get("backend") {
            name.parse::<Backend>()?;
        }
        if let Some(toml::Value::String(name)) = given.get("optimiser") {
            name.parse::<Optimiser>()?;
        }
        let mut table = toml::Table::try_from(base).map_err(|e| refused(&e))?;
        overlay(&mut table, given);
        let config: Self = table.try_into().map_err(|e: toml::de::Error| refused(&e))?;
        config.validate()?;
        Ok((config, description))
    }
}

/// Merges `given` into `table`, recursively.
fn overlay(table: &mut toml::Table, given: toml::Table) {
    for (key, value) in given {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) if key == "vi_mlp" => {
                overlay(below, above);
            }
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}
