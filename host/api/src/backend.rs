//! What the routes need of a daemon, so that they are tested without one.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;

use ihd_daemon::model::{Command, CommandError, DeviceReport, Done, Lease, Notice};
use tokio::sync::broadcast;

use crate::model::{StoredLookup, StoredResult};

/// An answer that takes a while.
pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, CommandError>> + Send + 'a>>;

/// A number for Prometheus.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Name without prefix, as `store_seconds_total`.
    pub name: &'static str,
    /// What it is, with the unit.
    pub help: &'static str,
    /// Whether it only grows.
    pub counter: bool,
    /// Its value.
    pub value: f64,
}

/// Whether a daemon works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alive {
    /// The store takes what it is given.
    pub store: bool,
    /// Devices are looked after.
    pub supervisor: bool,
}

/// A daemon, as the routes see it. Text that came from a device is printable already.
pub trait Backend: Send + Sync + 'static {
    /// Every device.
    fn devices(&self) -> Vec<DeviceReport>;
    /// One device.
    fn device(&self, name: &str) -> Option<DeviceReport>;
    /// Carries out a command.
    fn command<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        command: Command,
    ) -> Answer<'a, Done>;
    /// Takes or renews the lease.
    fn take_lease<'a>(&'a self, device: &'a str, holder: &'a str, force: bool)
    -> Answer<'a, Lease>;
    /// Gives the lease back; power that was asked for under it ends.
    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> Answer<'a, ()>;
    /// Everything that happens from now on.
    fn watch(&self) -> broadcast::Receiver<Arc<Notice>>;
    /// Results of a device, newest first, at most `limit`, none before `since_ms` (1970, UTC).
    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> Answer<'a, Vec<StoredResult>>;
    /// Lookups of a device, newest first.
    fn lookups<'a>(&'a self, device: &'a str) -> Answer<'a, Vec<StoredLookup>>;
    /// Copies the store while it is in use.
    fn backup(&self, to: PathBuf) -> Answer<'_, ()>;
    /// Numbers for `/metrics`, beside those of the devices.
    fn figures(&self) -> Vec<Figure>;
    /// Whether it works.
    fn alive(&self) -> Answer<'_, Alive>;
}
