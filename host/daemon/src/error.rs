//! Errors of the daemon.

use std::path::PathBuf;

use crate::learning::LearnerError;
use crate::store_thread::StoreThreadError;

/// Error at the start of the daemon or in a query.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// Error of the store.
    #[error(transparent)]
    Store(#[from] ihd_store::StoreError),
    /// Error of the store's thread.
    #[error(transparent)]
    StoreThread(#[from] StoreThreadError),
    /// The store's thread could not be started.
    #[error("no thread could be started for the store: {0}")]
    NoThread(std::io::Error),
    /// The learner could not be started.
    #[error(transparent)]
    Learner(#[from] LearnerError),
    /// Invalid value in the configuration.
    #[error("the configuration: {0}")]
    Config(String),
    /// Unknown device.
    #[error("there is no device {0:?}")]
    NoDevice(String),
    /// The folder of recordings cannot be read.
    #[error("the recordings in {}: {source}", folder.display())]
    Recordings {
        /// The folder.
        folder: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
}
