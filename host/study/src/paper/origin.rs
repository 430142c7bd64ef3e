//! Origin of a cell: the program and the settings that made it.

use std::fs;
use std::hash::{DefaultHasher, Hasher};

use ihd_pinn::{PinnConfig, PresetLibrary};

use super::{Contender, PaperJob, PaperStudyError};

/// Version of this program and a sum over its file: another build of changed sources has another. Only the version where the file
/// cannot be read.
pub(super) fn build() -> String {
    let version = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));
    let Ok(program) = std::env::current_exe().and_then(fs::read) else {
        return version.to_owned();
    };
    let mut sum = DefaultHasher::new();
    sum.write(&program);
    format!("{version}, {:016x}", sum.finish())
}

/// Settings of the job's network; `None` for other estimators.
pub(super) fn settings(
    job: &PaperJob,
    presets: &PresetLibrary,
) -> Result<Option<PinnConfig>, PaperStudyError> {
    match &job.contender {
        Contender::Pinn(preset) => configured(job, preset, presets).map(Some),
        Contender::Other(_) => Ok(None),
    }
}

/// Settings of a preset with what the job changes of it.
pub(super) fn configured(
    job: &PaperJob,
    preset: &str,
    presets: &PresetLibrary,
) -> Result<PinnConfig, PaperStudyError> {
    let named = presets.get(preset);
    let mut config = named
        .map(|named| named.config)
        .map_err(|source| PaperStudyError::Pinn {
            cell: job.file_stem(),
            source,
        })?;
    config.seed = job.seed;
    config.deterministic = true;
    if config.vi_mlp.is_some() {
        config.backend = job.backend.unwrap_or(config.backend);
        config.max_iterations = job.epochs.unwrap_or(config.max_iterations);
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_every_preset_are_the_same_out_of_their_file() {
        let presets = PresetLibrary::default();
        for name in presets.names() {
            let config = presets.get(name).unwrap().config;
            let text = serde_json::to_vec(&config).unwrap();
            assert_eq!(
                serde_json::from_slice::<PinnConfig>(&text).unwrap(),
                config,
                "{name}"
            );
        }
    }
}
