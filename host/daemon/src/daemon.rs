//! Interface of the daemon: devices, commands, leases, events.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_capture::recording::name_of;
use ihd_model::{
    Command, CommandError, CommandReply, DaemonEvent, DeviceReport, EventKind, Lease, PotCurve,
    RecordKind, RecordingFile, Trigger,
};
use ihd_store::{DeviceId, LookupRow, ResultFilter, ResultRow, Store, StoreError};
use tokio::sync::{Semaphore, broadcast, mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::OpenDevice;
use crate::auditor::Auditor;
use crate::config::Config;
use crate::context::Context;
use crate::device::{DeviceRequest, not_connected_error};
use crate::device_record::DeviceRecord;
use crate::event_bus::EventBus;
use crate::event_log;
use crate::figures::{Figures, rss_bytes};
use crate::fleet::delegation::Delegation;
use crate::fleet_view::FleetView;
use crate::history::{self, TelemetryBuffer};
use crate::learning::{Learner, LearnerError, LearnerSettings};
use crate::lease::{LeaseGrant, LeaseId};
use crate::live::LiveTap;
use crate::locking::lock;
use crate::machine::Machine;
use crate::printable::printable;
use crate::recording::list;
use crate::routing::route;
use crate::store_thread::{StoreThread, StoreThreadError};
use crate::store_watch;
use crate::supervisor::{Devices, Handle, follow_usb};
use crate::switching_off::switch_off;
use crate::view::cell_ages::CellAges;

/// Time limit of a command.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(15);

/// Period of the store's garbage collection.
const GARBAGE_PERIOD: Duration = Duration::from_secs(600);

/// Capacity of the queue of learning results for the store.
const RESULTS: usize = 64;

/// Time limit at the stop for the learner's fits under way.
const LEARNER_TIMEOUT: Duration = Duration::from_secs(10);

/// Longest name of a holder, in characters.
const LONGEST_HOLDER: usize = 128;

/// Largest number of concurrent readers of the store; further ones wait.
const READERS: usize = 4;

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

/// The daemon; cheap to clone.
#[derive(Clone)]
pub struct Daemon {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    machine: Machine,
    event_bus: EventBus,
    store: StoreThread,
    auditor: Auditor,
    recordings: PathBuf,
    /// Folder of the store, for readers.
    pub(crate) folder: PathBuf,
    pub(crate) readers: Semaphore,
    pub(crate) devices: Arc<Devices>,
    /// Telemetry that is not stored yet.
    pub(crate) telemetry: Arc<TelemetryBuffer>,
    /// Ages of the lookup cells, by device.
    pub(crate) ages: Mutex<BTreeMap<String, CellAges>>,
    /// Last report of the fleet.
    pub(crate) fleet: FleetView,
    learner: Mutex<Option<Arc<Learner>>>,
    pub(crate) delegation: Arc<Delegation>,
    routing: Mutex<Option<JoinHandle<()>>>,
    stop: watch::Sender<bool>,
    began: Instant,
    /// Damaged files set aside at the start, as text.
    damage: Mutex<Vec<String>>,
}

impl Daemon {
    /// Opens the store and starts a task for each device. Heats nothing.
    ///
    /// # Errors
    /// [`DaemonError`] if the store cannot be opened or another process uses it.
    pub async fn start(config: Config, open: Arc<OpenDevice>) -> Result<Self, DaemonError> {
        Self::start_on(Machine::default(), config, open).await
    }

    /// Returns the wall clock in milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        self.inner.machine.now_ms()
    }

    /// Starts the daemon on a given machine; see [`Daemon::start`].
    ///
    /// # Errors
    /// As [`Daemon::start`].
    pub(crate) async fn start_on(
        machine: Machine,
        config: Config,
        open: Arc<OpenDevice>,
    ) -> Result<Self, DaemonError> {
        let event_bus = EventBus::new(machine.clone());
        let network = config.network().map_err(DaemonError::Config)?;
        let (folder, settings) = (config.store.clone(), config.store_settings());
        let clock = machine.clock();
        let opening = machine
            .spawn_blocking(move || Store::open_with_clock(&folder, &settings, clock))
            .await;
        let opened = opening.map_err(|_| StoreThreadError::Gone("opening it panicked"))??;
        let mut damage = Vec::new();
        for file in opened.damage {
            let text = format!(
                "{} was damaged ({}), and is {} now",
                file.from.display(),
                printable(&file.why),
                file.to.display()
            );
            tracing::error!(text, "store: a damaged file was set aside");
            damage.push(text);
        }
        let store = StoreThread::start(opened.store, event_bus.clone(), &machine)
            .map_err(DaemonError::NoThread)?;
        let (stop, stopped) = watch::channel(false);
        let (results, learned) = mpsc::channel(RESULTS);
        let settings = LearnerSettings {
            threads: config.learning.threads,
            queue: config.learning.queue,
            network,
        };
        let learner = Arc::new(Learner::start_on(&machine, settings, results)?);
        let telemetry = Arc::new(TelemetryBuffer::default());
        let delegation = Arc::new(Delegation::new(config.fleet.is_some()));
        let recordings = config.store.join("recordings");
        let auditor = Auditor::start(store.clone(), stopped.clone());
        let context = Context {
            machine: machine.clone(),
            store: store.clone(),
            telemetry: Arc::clone(&telemetry),
            learner: Arc::clone(&learner),
            delegation: Arc::clone(&delegation),
            open,
            recordings: recordings.clone(),
            stop: stopped,
        };
        let devices = Arc::new(Devices::default());
        // Subscribed before the first event is published.
        devices.spawn(event_log::run(context.clone(), event_bus.subscribe()));
        devices.spawn(history::write_periodically(context.clone()));
        for device in &config.devices {
            let (name, address) = (device.name.clone(), device.address.clone());
            devices.start(name, address, &context, &event_bus);
        }
        if config.discovers_usb() {
            let following = follow_usb(Arc::clone(&devices), context.clone(), event_bus.clone());
            devices.spawn(following);
        }
        devices.spawn(store_watch::watch(context.clone()));
        devices.spawn(collect_garbage(context));
        let routing = tokio::spawn(route(
            learned,
            Arc::clone(&devices),
            store.clone(),
            Arc::downgrade(&learner),
            machine.clone(),
        ));
        Ok(Self {
            inner: Arc::new(Inner {
                machine,
                event_bus,
                store,
                auditor,
                recordings,
                folder: config.store,
                readers: Semaphore::new(READERS),
                devices,
                telemetry,
                ages: Mutex::default(),
                fleet: FleetView::default(),
                learner: Mutex::new(Some(learner)),
                delegation,
                routing: Mutex::new(Some(routing)),
                stop,
                began: Instant::now(),
                damage: Mutex::new(damage),
            }),
        })
    }

    /// Returns the reports of all devices, sorted by name.
    pub fn devices(&self) -> Vec<DeviceReport> {
        let all = self.inner.devices.all();
        all.iter().map(|handle| handle.record.report()).collect()
    }

    /// Returns the report of a device; `None` if it is unknown.
    pub fn device(&self, name: &str) -> Option<DeviceReport> {
        Some(self.inner.devices.get(name)?.record.report())
    }

    /// Returns the temperature curve of a device's pot over the last hour; `None` if the device is unknown.
    pub fn pot_curve(&self, name: &str) -> Option<PotCurve> {
        Some(self.inner.devices.get(name)?.record.pot_curve().clone())
    }

    /// Returns the learner; `None` once the daemon stops.
    pub(crate) fn learner(&self) -> Option<Arc<Learner>> {
        lock(&self.inner.learner).clone()
    }

    pub(crate) fn handle_of(&self, name: &str) -> Option<Handle> {
        self.inner.devices.get(name)
    }

    /// Runs `f` on the store's thread.
    pub(crate) async fn in_store<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreThreadError> {
        self.inner.store.run(f).await
    }

    fn handle(&self, name: &str) -> Result<Handle, CommandError> {
        let handle = self.handle_of(name);
        handle.ok_or_else(|| CommandError::NoDevice {
            name: printable(name),
        })
    }

    /// Carries out a command. All but [`Command::Off`] and recordings need the lease. A free lease is taken for the duration of the
    /// command, and for [`crate::lease::LEASE_S`] if it heats. [`Command::Off`] waits for no other command and cancels earlier power
    /// requests. The audit is written after the response.
    ///
    /// # Errors
    /// [`CommandError`] if the command was not carried out.
    pub async fn command(
        &self,
        device: &str,
        holder: &str,
        command: Command,
    ) -> Result<CommandReply, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let text = describe(&command);
        let outcome = self.carry_out(&handle, &holder, command).await;
        let response = match &outcome {
            Ok(reply) => reply.text.clone(),
            Err(error) => error.to_string(),
        };
        let ok = outcome.is_ok();
        tracing::info!(
            device = handle.record.name,
            holder,
            command = text,
            ok,
            response,
            "command"
        );
        handle.record.publish(EventKind::Command {
            holder: holder.clone(),
            text: text.clone(),
            ok,
        });
        let auditor = &self.inner.auditor;
        auditor.record(&handle.record, holder, text, response);
        outcome
    }

    async fn carry_out(
        &self,
        handle: &Handle,
        holder: &str,
        command: Command,
    ) -> Result<CommandReply, CommandError> {
        let record = &handle.record;
        let lease = match command {
            Command::Off => return self.off(handle).await,
            // A recording only observes and needs no lease.
            Command::RecordStart(_) | Command::RecordStop => None,
            _ => Some(self.borrow_lease(record, holder)?),
        };
        let outcome = match command {
            Command::Power { power_w: 0 } => self.off(handle).await,
            _ => self.request(handle, command, lease).await,
        };
        if lease.is_some_and(|id| record.lock().lease.end_command(id)) {
            self.publish_lease(record, "", "");
        }
        outcome
    }

    /// Sends a command to the device's task and waits for its outcome.
    async fn request(
        &self,
        handle: &Handle,
        command: Command,
        lease: Option<LeaseId>,
    ) -> Result<CommandReply, CommandError> {
        let (reply, replied) = oneshot::channel();
        let request = DeviceRequest::Command {
            command,
            lease,
            reply,
        };
        let outcome = tokio::time::timeout(COMMAND_TIMEOUT, async {
            handle.requests.send(request).await.ok()?;
            replied.await.ok()
        });
        match outcome.await {
            Ok(Some(outcome)) => outcome,
            // The device's task panicked or is ending.
            Ok(None) => Err(CommandError::Failed {
                why: format!(
                    "{}: the command was not carried out: its task ended",
                    handle.record.name
                ),
            }),
            Err(_) => Err(timed_out(&handle.record)),
        }
    }

    /// Switches off at once, ahead of all other requests, and cancels earlier power requests.
    async fn off(&self, handle: &Handle) -> Result<CommandReply, CommandError> {
        let record = &handle.record;
        let client = {
            let mut inner = record.lock();
            inner.lease.off();
            inner.sweep_left_w.clear();
            inner.client.clone()
        };
        let client = client.ok_or_else(|| not_connected_error(record))?;
        let off = tokio::time::timeout(COMMAND_TIMEOUT, switch_off(record, &client));
        let off = off.await.map_err(|_| timed_out(record))?;
        // After an error the device's task tries again until the device confirms.
        off.map_err(|error| CommandError::Refused {
            name: record.name.clone(),
            why: printable(&error.to_string()),
        })?;
        Ok(CommandReply {
            text: "off".to_owned(),
            file: None,
        })
    }

    /// Takes the lease or renews it. With `force` it is also taken from another holder; that is published, and the
    /// heating of the other ends.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it.
    pub async fn take_lease(
        &self,
        device: &str,
        holder: &str,
        force: bool,
    ) -> Result<Lease, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let record = &handle.record;
        let grant = record.lock().lease.take(&holder, force, Instant::now());
        let grant = grant.map_err(|lease| leased_error(record, lease))?;
        self.publish_grant(record, &holder, &grant);
        if let LeaseGrant::From(other) = grant {
            let why = format!("{holder} has taken the lease from {other}");
            tracing::warn!(device = record.name, "{why}");
            let command = "take-lease --force".to_owned();
            let auditor = &self.inner.auditor;
            auditor.record(record, holder.clone(), command, why.clone());
            self.end_heating(&handle, why).await;
        }
        let now = Instant::now();
        let lease = record.lock().lease.current(now);
        lease.ok_or_else(|| CommandError::Failed {
            why: format!("{}: the lease ran out meanwhile", record.name),
        })
    }

    /// Takes or renews the lease for one command.
    fn borrow_lease(&self, record: &DeviceRecord, holder: &str) -> Result<LeaseId, CommandError> {
        let begun = record.lock().lease.begin_command(holder, Instant::now());
        let (id, grant) = begun.map_err(|lease| leased_error(record, lease))?;
        self.publish_grant(record, holder, &grant);
        Ok(id)
    }

    fn publish_grant(&self, record: &DeviceRecord, holder: &str, grant: &LeaseGrant) {
        match grant {
            LeaseGrant::Renewed => {}
            LeaseGrant::New => self.publish_lease(record, holder, ""),
            LeaseGrant::From(other) => self.publish_lease(record, holder, other),
        }
    }

    fn publish_lease(&self, record: &DeviceRecord, holder: &str, taken_from: &str) {
        record.publish(EventKind::Lease {
            holder: holder.to_owned(),
            taken_from: taken_from.to_owned(),
            why: String::new(),
        });
    }

    /// Releases the lease and switches off its power.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it.
    pub async fn release_lease(&self, device: &str, holder: &str) -> Result<(), CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let record = &handle.record;
        let now = Instant::now();
        let (released, other) = {
            let mut inner = record.lock();
            (inner.lease.release(&holder), inner.lease.current(now))
        };
        if let Some(other) = other {
            return Err(leased_error(record, other));
        }
        if released {
            self.publish_lease(record, "", "");
            self.end_heating(&handle, format!("{holder} has given the lease back"))
                .await;
        }
        Ok(())
    }

    /// Switches off the power of a lease that has ended.
    async fn end_heating(&self, handle: &Handle, why: String) {
        let record = &handle.record;
        let client = {
            let inner = record.lock();
            let must_switch_off = inner.lease.must_switch_off(Instant::now());
            inner.client.clone().filter(|_| must_switch_off)
        };
        let Some(client) = client else { return };
        tracing::info!(device = record.name, why, "off");
        let (name, address) = (record.name.clone(), record.address.clone());
        // Without room in the store the event is in the log only.
        let store = self.inner.store.writing_once(RecordKind::Events);
        store.offer(move |store| {
            let device = store.device(&name, &address)?;
            store.event(Some(device), "off", &why)
        });
        let off = tokio::time::timeout(COMMAND_TIMEOUT, switch_off(record, &client));
        if !matches!(off.await, Ok(Ok(()))) {
            tracing::warn!(device = record.name, "was not switched off in time");
        }
    }

    /// Subscribes to all events from now on.
    pub fn watch(&self) -> broadcast::Receiver<Arc<DaemonEvent>> {
        self.inner.event_bus.subscribe()
    }

    /// Returns a tap of the devices' telemetry, polled at the rate of its reader.
    pub fn live(&self) -> LiveTap {
        LiveTap::new(Arc::clone(&self.inner.devices))
    }

    /// Returns the figures of the daemon.
    pub fn figures(&self) -> Figures {
        let learner = self.learner();
        Figures {
            learner: learner.map(|l| l.figures()).unwrap_or_default(),
            devices: self.inner.devices.all().len(),
            up_s: self.inner.began.elapsed().as_secs_f64(),
            rss_bytes: rss_bytes(),
            audit_is_healthy: self.inner.auditor.is_healthy(),
            audits_lost: self.inner.auditor.lost(),
            ..Figures::from_store(&self.inner.store)
        }
    }

    /// Returns the files of the store that were damaged at the start and set aside, as text.
    pub fn damage(&self) -> Vec<String> {
        lock(&self.inner.damage).clone()
    }

    /// Returns results, newest first.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn results(&self, filter: ResultFilter) -> Result<Vec<ResultRow>, DaemonError> {
        let results = self.inner.store.run(move |store| store.results(&filter));
        Ok(results.await?)
    }

    /// Returns all lookups of a device, oldest first.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn lookups(&self, device: &str) -> Result<Vec<LookupRow>, DaemonError> {
        let handle = self.inner.devices.get(device);
        let handle = handle.ok_or_else(|| DaemonError::NoDevice(printable(device)))?;
        let (name, address) = (handle.record.name.clone(), handle.record.address.clone());
        let lookups = self.inner.store.run(move |store| {
            let device: DeviceId = store.device(&name, &address)?;
            store.lookups(device)
        });
        Ok(lookups.await?)
    }

    /// Returns the folder of recordings.
    pub fn recordings_folder(&self) -> &Path {
        &self.inner.recordings
    }

    /// Returns all recordings, newest first.
    ///
    /// # Errors
    /// [`DaemonError::Recordings`] if their folder cannot be read.
    pub async fn recordings(&self) -> Result<Vec<RecordingFile>, DaemonError> {
        let handles = self.inner.devices.all();
        let devices: Vec<String> = handles.iter().map(|h| h.record.name.clone()).collect();
        let writing = handles.iter().flat_map(|h| h.record.recorder.incomplete());
        let writing: Vec<String> = writing.map(|path| name_of(&path)).collect();
        let folder = self.inner.recordings.clone();
        let failed = |source| DaemonError::Recordings {
            folder: self.inner.recordings.clone(),
            source,
        };
        let listed = tokio::task::spawn_blocking(move || list(&folder, &devices, &writing)).await;
        listed.map_err(|e| failed(e.into()))?.map_err(failed)
    }

    /// Copies the store while it is in use.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn backup(&self, to: PathBuf) -> Result<(), DaemonError> {
        // Not on the store's thread, which would delay windows.
        let from = self.inner.folder.clone();
        let backup = tokio::task::spawn_blocking(move || ihd_store::backup(&from, &to)).await;
        Ok(backup.map_err(|_| StoreThreadError::Gone("the backup panicked"))??)
    }

    /// Stops the daemon: switches off the power requested through it, stores pending data, closes the store.
    pub async fn stop(self) {
        self.inner.stop.send_replace(true);
        self.inner.devices.join().await;
        self.inner.auditor.close().await;
        let now_ms = self.inner.machine.now_ms();
        history::write(&self.inner.telemetry, &self.inner.store, now_ms, true).await;
        // Store jobs of windows hold the learner.
        self.inner.store.idle().await;
        drop(lock(&self.inner.learner).take());
        let routing = lock(&self.inner.routing).take();
        if let Some(routing) = routing {
            // Ends once the learner's threads have finished their fits.
            let _ = tokio::time::timeout(LEARNER_TIMEOUT, routing).await;
        }
        self.inner.store.close().await;
    }
}

/// Collects the store's garbage periodically.
async fn collect_garbage(context: Context) {
    loop {
        // Errors of the store are reported by its thread.
        let store = context.store.writing(RecordKind::State);
        let _ = store.run(Store::collect_garbage).await;
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(GARBAGE_PERIOD) => {}
        }
    }
}

fn timed_out(record: &DeviceRecord) -> CommandError {
    CommandError::Failed {
        why: format!(
            "{}: the command was not carried out within {} s",
            record.name,
            COMMAND_TIMEOUT.as_secs()
        ),
    }
}

fn leased_error(record: &DeviceRecord, lease: Lease) -> CommandError {
    CommandError::Leased {
        name: record.name.clone(),
        holder: lease.holder,
        expires_in_s: lease.expires_in_s,
    }
}

/// Returns a holder's name from the API as printable, limited text for logs and terminals.
fn holder_name(holder: &str) -> String {
    let name: String = printable(holder).chars().take(LONGEST_HOLDER).collect();
    match name.trim() {
        "" => "somebody".to_owned(),
        name => name.to_owned(),
    }
}

/// Describes a command for logs and the audit.
fn describe(command: &Command) -> String {
    match command {
        Command::Power { power_w } => format!("power {power_w} W"),
        Command::Off => "off".to_owned(),
        Command::ClearFault => "clear-fault".to_owned(),
        Command::LookupPush { blob } => format!("lookup push ({} bytes)", blob.len()),
        Command::LookupRollback { version: None } => "lookup rollback".to_owned(),
        Command::LookupRollback {
            version: Some(version),
        } => format!("lookup rollback to version {version}"),
        Command::LookupReset => "lookup reset".to_owned(),
        Command::Sweep { powers_w } => {
            let powers: Vec<_> = powers_w.iter().take(64).map(u16::to_string).collect();
            format!("sweep {} W", powers.join(", "))
        }
        Command::RecordStart(settings) => match settings.trigger {
            Trigger::Now => "record start".to_owned(),
            trigger => format!("record start at {trigger}"),
        },
        Command::RecordStop => "record stop".to_owned(),
    }
}
