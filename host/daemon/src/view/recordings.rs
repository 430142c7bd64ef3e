//! Files of recordings.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ihd_capture::recording::name_of;
use ihd_model::RecordingFile;

use crate::error::DaemonError;
use crate::recording::list;
use crate::supervisor::Devices;

/// Access to recordings, finished and running.
pub struct Recordings {
    pub(crate) devices: Arc<Devices>,
    pub(crate) folder: PathBuf,
}

impl Recordings {
    /// Returns the folder of recordings.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns all recordings, newest first.
    ///
    /// # Errors
    /// [`DaemonError::Recordings`] if their folder cannot be read.
    pub async fn list(&self) -> Result<Vec<RecordingFile>, DaemonError> {
        let handles = self.devices.all();
        let devices: Vec<String> = handles.iter().map(|h| h.record.name.clone()).collect();
        let writing = handles.iter().flat_map(|h| h.record.recorder.incomplete());
        let writing: Vec<String> = writing.map(|path| name_of(&path)).collect();
        let folder = self.folder.clone();
        let failed = |source| DaemonError::Recordings {
            folder: self.folder.clone(),
            source,
        };
        let listed = tokio::task::spawn_blocking(move || list(&folder, &devices, &writing)).await;
        listed.map_err(|e| failed(e.into()))?.map_err(failed)
    }
}
