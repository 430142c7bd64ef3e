//! What the routes need of a daemon, so that they are tested without one.

use std::future::Future;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::JournalFilter;
use ihd_daemon::model::{
    Command, CommandError, DeviceReport, Done, Fit, FleetReport, History, Hob, JournalEntry, Lease,
    LiveTelemetry, Map, Notice, PotCurve, RecordingFile, Scope, StoreFailure, WindowSummary,
    WindowWanted,
};
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
    /// Name and value of its label, where a family has several samples: these follow one another.
    pub label: Option<(&'static str, &'static str)>,
    /// Whether it only grows.
    pub counter: bool,
    /// Its value.
    pub value: f64,
}

/// Whether a daemon works.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alive {
    /// Why the store does not take what it is given; `None` while it does.
    pub store_failure: Option<StoreFailure>,
    /// Devices are looked after.
    pub supervisor: bool,
    /// All commands so far are in the audit, or on their way to it.
    pub audit: bool,
}

/// One watcher's look at what devices do.
pub trait Tap: Send {
    /// What is new since it was asked last; never waits.
    fn take(&mut self) -> LiveTelemetry;
}

/// A daemon, as the routes see it. Text that came from a device is printable already.
pub trait Backend: Send + Sync + 'static {
    /// What every hob of this build has.
    fn hob(&self) -> Hob;
    /// Every device.
    fn devices(&self) -> Vec<DeviceReport>;
    /// One device.
    fn device(&self, name: &str) -> Option<DeviceReport>;
    /// What is known of the fleet; `None`: the daemon is no edge of one.
    fn fleet(&self) -> Option<Arc<FleetReport>>;
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
    /// What devices do from now on, for a watcher who means to ask this often.
    fn live(&self, every: Duration) -> Box<dyn Tap>;
    /// Results of a device, newest first, at most `limit`, none before `since_ms` (1970, UTC).
    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> Answer<'a, Vec<StoredResult>>;
    /// Lookups of a device, newest first.
    fn lookups<'a>(&'a self, device: &'a str) -> Answer<'a, Vec<StoredLookup>>;
    /// Recordings, newest first.
    fn recordings(&self) -> Answer<'_, Vec<RecordingFile>>;
    /// The folder that they are in.
    fn recordings_folder(&self) -> PathBuf;
    /// What a device did between two times (1970, UTC), in at most `columns`.
    fn history<'a>(
        &'a self,
        device: &'a str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> Answer<'a, History>;
    /// Windows of a device, newest first.
    fn windows<'a>(&'a self, device: &'a str, limit: usize) -> Answer<'a, Vec<WindowSummary>>;
    /// A window of a device, where the store has its samples.
    fn scope<'a>(&'a self, device: &'a str, wanted: WindowWanted) -> Answer<'a, Option<Scope>>;
    /// Fits of a device, newest first.
    fn training<'a>(&'a self, device: &'a str, limit: usize) -> Answer<'a, Vec<Fit>>;
    /// A lookup of a device: of this version, or the one it uses.
    fn map<'a>(&'a self, device: &'a str, version: Option<u32>) -> Answer<'a, Option<Map>>;
    /// How warm the pot on a device is, over the last hour; `None`: no such device.
    fn pot_curve(&self, device: &str) -> Option<PotCurve>;
    /// What happened, newest first.
    fn journal(&self, filter: JournalFilter) -> Answer<'_, Vec<JournalEntry>>;
    /// Copies the store while it is in use.
    fn backup(&self, to: PathBuf) -> Answer<'_, ()>;
    /// Numbers for `/metrics`, beside those of the devices.
    fn figures(&self) -> Vec<Figure>;
    /// Whether it works.
    fn alive(&self) -> Answer<'_, Alive>;
}
