//! Interface between the routes and a daemon; tests implement it without one.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::JournalFilter;
use ihd_daemon::model::{
    Command, CommandError, CommandReply, DaemonEvent, DeviceReport, Fit, FleetReport, History, Hob,
    JournalEntry, Lease, LiveTelemetry, Map, PotCurve, RecordingFile, Scope, StoreFailure,
    WindowQuery, WindowSummary,
};
use tokio::sync::broadcast;

use crate::model::{StoredLookup, StoredResult};

/// Pending result of a request to the daemon.
pub type BackendFuture<'a, T> = Pin<Box<dyn Future<Output = Result<T, CommandError>> + Send + 'a>>;

/// One sample for Prometheus.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Name without prefix, for example `store_busy_seconds_total`.
    pub name: &'static str,
    /// Description with unit.
    pub help: &'static str,
    /// Name and value of its label; `None` if the family has one sample. Samples of a family are consecutive.
    pub label: Option<(&'static str, &'static str)>,
    /// `true` for a counter, `false` for a gauge.
    pub counter: bool,
    /// Value in the unit of the description.
    pub value: f64,
}

/// Health of a daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Liveness {
    /// Failure of the store; `None` while it accepts records.
    pub store_failure: Option<StoreFailure>,
    /// `true` while devices are supervised.
    pub supervisor: bool,
    /// `true` while all commands so far are in the audit or queued for it.
    pub audit: bool,
}

/// Live telemetry for one subscriber.
pub trait LiveSource: Send {
    /// Returns the telemetry since the last call, without waiting.
    fn collect(&mut self) -> LiveTelemetry;
}

/// Daemon behind the routes. Text from a device must be printable already.
///
/// Futures end with [`CommandError::NoDevice`] if there is no device of that name.
pub trait Backend: Send + Sync + 'static {
    /// Returns ratings and limits of all hobs of this build.
    fn hob(&self) -> Hob;
    /// Returns the reports of all devices.
    fn devices(&self) -> Vec<DeviceReport>;
    /// Returns the report of a device; `None` if there is none of that name.
    fn device(&self, name: &str) -> Option<DeviceReport>;
    /// Returns the last report of the fleet; `None` if the daemon is not an edge of one.
    fn fleet(&self) -> Option<Arc<FleetReport>>;
    /// Executes a command.
    fn command<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        command: Command,
    ) -> BackendFuture<'a, CommandReply>;
    /// Acquires or renews the lease; `force` revokes that of another holder.
    fn take_lease<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        force: bool,
    ) -> BackendFuture<'a, Lease>;
    /// Releases the lease; power requested under it ends.
    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> BackendFuture<'a, ()>;
    /// Subscribes to all events from now on.
    fn watch(&self) -> broadcast::Receiver<Arc<DaemonEvent>>;
    /// Returns live telemetry from now on, for a subscriber that collects it once per `every`.
    fn live(&self, every: Duration) -> Box<dyn LiveSource>;
    /// Returns at most `limit` results of a device, newest first, none before `since_ms` (milliseconds since 1970, UTC).
    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> BackendFuture<'a, Vec<StoredResult>>;
    /// Returns the lookups of a device, newest first.
    fn lookups<'a>(&'a self, device: &'a str) -> BackendFuture<'a, Vec<StoredLookup>>;
    /// Returns the recordings, newest first.
    fn recordings(&self) -> BackendFuture<'_, Vec<RecordingFile>>;
    /// Returns the folder of the recordings.
    fn recordings_folder(&self) -> PathBuf;
    /// Returns telemetry between two times (milliseconds since 1970, UTC) in at most `columns` columns.
    fn history<'a>(
        &'a self,
        device: &'a str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> BackendFuture<'a, History>;
    /// Returns at most `limit` windows of a device, newest first.
    fn windows<'a>(
        &'a self,
        device: &'a str,
        limit: usize,
    ) -> BackendFuture<'a, Vec<WindowSummary>>;
    /// Returns a window of a device; `None` if the store does not have its samples.
    fn scope<'a>(&'a self, device: &'a str, query: WindowQuery)
    -> BackendFuture<'a, Option<Scope>>;
    /// Returns at most `limit` fits of a device, newest first.
    fn training<'a>(&'a self, device: &'a str, limit: usize) -> BackendFuture<'a, Vec<Fit>>;
    /// Returns the lookup of this version as a map, or the one that the device uses if `version` is `None`.
    fn map<'a>(&'a self, device: &'a str, version: Option<u32>) -> BackendFuture<'a, Option<Map>>;
    /// Returns the pot temperature over the last hour; `None` if there is no such device.
    fn pot_curve(&self, device: &str) -> Option<PotCurve>;
    /// Returns events and commands, newest first.
    fn journal(&self, filter: JournalFilter) -> BackendFuture<'_, Vec<JournalEntry>>;
    /// Copies the store to `to` while it is in use.
    fn backup(&self, to: PathBuf) -> BackendFuture<'_, ()>;
    /// Returns the samples for `/metrics` that are not of a device.
    fn metrics(&self) -> Vec<Metric>;
    /// Returns the health of the daemon.
    fn liveness(&self) -> BackendFuture<'_, Liveness>;
}
