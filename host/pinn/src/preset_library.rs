//! All presets by name: those in code ([`Preset`]), the ablations of host/pinn/presets, whose files are part
//! of the program, and TOML files of a folder.

use std::fs;
use std::path::Path;

use crate::{PinnConfig, PinnError, Preset};

/// Name and text of each ablation's file.
macro_rules! ablations {
    ($($name:literal),* $(,)?) => {
        [$(($name, include_str!(concat!("../presets/", $name, ".toml")))),*]
    };
}

const ABLATIONS: [(&str, &str); 9] = ablations![
    "repaired-unscaled",
    "repaired-fast-only",
    "repaired-eq3",
    "repaired-minibatch",
    "repaired-decay",
    "hybrid-paper-net",
    "hybrid-adam",
    "hybrid-no-prior",
    "at-once",
];

/// Configuration with a name.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedConfig {
    /// Name in commands and files.
    pub name: String,
    /// Description in one line; empty if its file has no `description`.
    pub description: String,
    /// Settings of the preset.
    pub config: PinnConfig,
}

/// Presets of the program, and those of a folder if one was given.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PresetLibrary {
    folder: Vec<NamedConfig>,
}

impl PresetLibrary {
    /// Reads the `*.toml` files of `folder`, each named as its file, in addition to the program's presets.
    ///
    /// # Errors
    /// [`PinnError::File`] with the file, if one cannot be read, holds no settings, or has the name
    /// of another preset.
    pub fn with_folder(folder: &Path) -> Result<Self, PinnError> {
        let entries = fs::read_dir(folder).map_err(|e| broken(folder, &e))?;
        let mut paths = Vec::new();
        for entry in entries {
            let path = entry.map_err(|e| broken(folder, &e))?.path();
            if path.extension().is_some_and(|ending| ending == "toml") {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            return Err(broken(folder, &"holds no preset, no *.toml file"));
        }
        paths.sort();
        let folder = paths.iter().map(|path| read(path));
        Ok(Self {
            folder: folder.collect::<Result<_, _>>()?,
        })
    }

    /// Finds the preset of this name.
    ///
    /// # Errors
    /// [`PinnError::UnknownName`] with the valid names.
    pub fn get(&self, name: &str) -> Result<NamedConfig, PinnError> {
        if let Some(preset) = Preset::ALL.into_iter().find(|p| p.name() == name) {
            return Ok(NamedConfig {
                name: name.to_owned(),
                description: preset.description().to_owned(),
                config: preset.config(),
            });
        }
        if let Some((_, text)) = ABLATIONS.iter().find(|(ablation, _)| *ablation == name) {
            return parse(name, text);
        }
        let preset = self.folder.iter().find(|preset| preset.name == name);
        preset.cloned().ok_or_else(|| PinnError::UnknownName {
            what: "preset",
            name: name.to_owned(),
            known: self.names().join(", "),
        })
    }

    /// All names: those in code, the ablations, the folder's.
    #[must_use]
    pub fn names(&self) -> Vec<&str> {
        let code = Preset::ALL.iter().map(|preset| preset.name());
        let ablations = ABLATIONS.iter().map(|(name, _)| *name);
        code.chain(ablations).chain(self.folder_names()).collect()
    }

    /// Names of the folder's presets.
    pub fn folder_names(&self) -> impl Iterator<Item = &str> {
        self.folder.iter().map(|preset| preset.name.as_str())
    }
}

/// Reads the preset in a file of a folder.
fn read(path: &Path) -> Result<NamedConfig, PinnError> {
    let name = path.file_stem().and_then(|stem| stem.to_str());
    // The name becomes part of the names of a study's files.
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let name = name
        .filter(|name| name.chars().all(fits))
        .ok_or_else(|| broken(path, &"is named with more than letters, digits, - and _"))?;
    if PresetLibrary::default().names().contains(&name) {
        let taken = "has the name of one of the program's presets; rename it";
        return Err(broken(path, &taken));
    }
    let text = fs::read_to_string(path).map_err(|e| broken(path, &e))?;
    parse(name, &text).map_err(|e| match e {
        PinnError::File { detail } => broken(path, &detail.trim_end()),
        other => broken(path, &other),
    })
}

fn parse(name: &str, text: &str) -> Result<NamedConfig, PinnError> {
    let (config, description) = PinnConfig::from_described_toml(text)?;
    Ok(NamedConfig {
        name: name.to_owned(),
        description: description.unwrap_or_default(),
        config,
    })
}

fn broken(path: &Path, why: &dyn std::fmt::Display) -> PinnError {
    PinnError::File {
        detail: format!("{}: {why}", path.display()),
    }
}
