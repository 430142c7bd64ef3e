//! Interface of the daemon: start, stop, commands, leases, events, and access to what it knows.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_model::{Command, CommandError, CommandReply, DaemonEvent, Lease, RecordKind};
use ihd_store::{DamagedFile, Store};
use tokio::sync::{Semaphore, broadcast, mpsc, watch};
use tokio::time::Instant;

use crate::OpenDevice;
use crate::auditor::Auditor;
use crate::commander::Commander;
use crate::config::DaemonConfig;
use crate::context::Context;
use crate::error::DaemonError;
use crate::event_bus::EventBus;
use crate::event_log;
use crate::fleet::FleetAccess;
use crate::fleet::delegation::Delegation;
use crate::fleet_view::FleetView;
use crate::history::{self, TelemetryBuffer};
use crate::learning::{Learner, LearnerSettings, LearnerSlot};
use crate::machine::Machine;
use crate::printable::printable;
use crate::result_route::route_results;
use crate::running::Running;
use crate::store_thread::{StoreThread, StoreThreadError};
use crate::store_watch;
use crate::supervisor::{Devices, follow_usb};
use crate::upkeep::Upkeep;
use crate::view::{Recordings, View};

/// Period of the store's garbage collection.
const GARBAGE_PERIOD: Duration = Duration::from_secs(600);

/// Capacity of the queue of learning results for the store.
const MAX_QUEUED_RESULTS: usize = 64;

/// Largest number of concurrent readers of the store; further ones wait.
const READERS: usize = 4;

/// The daemon; cheap to clone.
#[derive(Clone)]
pub struct Daemon {
    inner: Arc<Inner>,
}

/// Parts of the daemon, each with what it reads.
struct Inner {
    commander: Arc<Commander>,
    event_bus: EventBus,
    view: View,
    fleet: FleetAccess,
    recordings: Recordings,
    upkeep: Upkeep,
    running: Running,
}

impl Daemon {
    /// Opens the store and starts a task for each device. Heats nothing.
    ///
    /// # Errors
    /// [`DaemonError`] if the store cannot be opened or another process uses it.
    pub async fn start(config: DaemonConfig, open: Arc<OpenDevice>) -> Result<Self, DaemonError> {
        Self::start_on(Machine::default(), config, open).await
    }

    /// Starts the daemon on a given machine; see [`Daemon::start`].
    ///
    /// # Errors
    /// As [`Daemon::start`].
    pub(crate) async fn start_on(
        machine: Machine,
        config: DaemonConfig,
        open: Arc<OpenDevice>,
    ) -> Result<Self, DaemonError> {
        let event_bus = EventBus::new(machine.clone());
        let network = config.network().map_err(DaemonError::Config)?;
        let (store, damage) = open_store(&machine, &config, &event_bus).await?;
        let (stop, stopped) = watch::channel(false);
        let (results, learned) = mpsc::channel(MAX_QUEUED_RESULTS);
        let settings = LearnerSettings {
            threads: config.learning.threads,
            queue: config.learning.queue,
            network,
        };
        let learner = Arc::new(Learner::start_on(&machine, settings, results)?);
        let telemetry = Arc::new(TelemetryBuffer::default());
        let delegation = Arc::new(Delegation::new(config.fleet.is_some()));
        let recordings = config.store.join("recordings");
        let auditor = Arc::new(Auditor::start(store.clone(), stopped.clone()));
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
        start_tasks(&config, &devices, context, &event_bus);
        let routing = tokio::spawn(route_results(
            learned,
            Arc::clone(&devices),
            store.clone(),
            Arc::downgrade(&learner),
            machine.clone(),
        ));
        let learner = LearnerSlot::new(learner);
        let inner = Inner {
            commander: Arc::new(Commander::new(
                Arc::clone(&devices),
                Arc::clone(&auditor),
                store.clone(),
            )),
            event_bus,
            view: View {
                machine: machine.clone(),
                devices: Arc::clone(&devices),
                telemetry: Arc::clone(&telemetry),
                folder: config.store.clone(),
                readers: Arc::new(Semaphore::new(READERS)),
                ages: Mutex::new(BTreeMap::new()),
            },
            fleet: FleetAccess {
                devices: Arc::clone(&devices),
                store: store.clone(),
                learner: learner.clone(),
                delegation,
                report: FleetView::default(),
                folder: config.store.clone(),
            },
            recordings: Recordings {
                devices: Arc::clone(&devices),
                folder: recordings,
            },
            upkeep: Upkeep {
                devices: Arc::clone(&devices),
                store: store.clone(),
                learner: learner.clone(),
                auditor: Arc::clone(&auditor),
                folder: config.store,
                began: Instant::now(),
                damage,
            },
            running: Running {
                machine,
                devices,
                auditor,
                telemetry,
                store,
                learner,
                routing: Mutex::new(Some(routing)),
                stop,
            },
        };
        Ok(Self {
            inner: Arc::new(inner),
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
        let (device, holder) = (device.to_owned(), holder.to_owned());
        self.to_its_end(
            |commander| async move { commander.command(&device, &holder, command).await },
        )
        .await
    }

    /// Takes the lease or renews it. With `force` it is also taken from another holder; that is published, and the
    /// heating of the other ends.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it; [`CommandError::Failed`] if the device does not confirm that it is off.
    pub async fn take_lease(
        &self,
        device: &str,
        holder: &str,
        force: bool,
    ) -> Result<Lease, CommandError> {
        let (device, holder) = (device.to_owned(), holder.to_owned());
        self.to_its_end(
            |commander| async move { commander.take_lease(&device, &holder, force).await },
        )
        .await
    }

    /// Releases the lease and switches off its power.
    ///
    /// # Errors
    /// [`CommandError::Leased`] if another holder has it; [`CommandError::Failed`] if the device does not confirm that it is off.
    pub async fn release_lease(&self, device: &str, holder: &str) -> Result<(), CommandError> {
        let (device, holder) = (device.to_owned(), holder.to_owned());
        self.to_its_end(|commander| async move { commander.release_lease(&device, &holder).await })
            .await
    }

    /// Carries something out in a task of its own: a client that leaves meanwhile takes neither its end nor its audit away.
    async fn to_its_end<T: Send + 'static, F>(
        &self,
        carry_out: impl FnOnce(Arc<Commander>) -> F,
    ) -> Result<T, CommandError>
    where
        F: Future<Output = Result<T, CommandError>> + Send + 'static,
    {
        let task = tokio::spawn(carry_out(Arc::clone(&self.inner.commander)));
        task.await.unwrap_or_else(|end| {
            let why = format!("a fault of this program, in the log: {end}");
            Err(CommandError::Failed { why })
        })
    }

    /// Subscribes to all events from now on.
    pub fn watch(&self) -> broadcast::Receiver<Arc<DaemonEvent>> {
        self.inner.event_bus.subscribe()
    }

    /// Returns the read model: reports, live values, stored data.
    pub fn view(&self) -> &View {
        &self.inner.view
    }

    /// Returns the access for the daemon's part in a fleet.
    pub fn fleet(&self) -> &FleetAccess {
        &self.inner.fleet
    }

    /// Returns the access to finished and running recordings.
    pub fn recordings(&self) -> &Recordings {
        &self.inner.recordings
    }

    /// Returns the access for whoever keeps the daemon running.
    pub fn upkeep(&self) -> &Upkeep {
        &self.inner.upkeep
    }

    /// Stops the daemon: switches off the power requested through it, stores pending data, closes the store.
    pub async fn stop(self) {
        self.inner.running.stop().await;
    }
}

#[cfg(any(test, feature = "simulation"))]
impl Daemon {
    /// Returns the learner; `None` once the daemon stops.
    pub(crate) fn learner(&self) -> Option<Arc<Learner>> {
        self.inner.running.learner.get()
    }

    /// Returns a device with the sender to its task; `None` if it is unknown.
    pub(crate) fn handle_of(&self, name: &str) -> Option<crate::supervisor::Handle> {
        self.inner.running.devices.get(name)
    }
}

/// Opens the store on a thread of its own; returns it with the damaged files that were set aside, as text.
async fn open_store(
    machine: &Machine,
    config: &DaemonConfig,
    event_bus: &EventBus,
) -> Result<(StoreThread, Vec<String>), DaemonError> {
    let (folder, settings) = (config.store.clone(), config.store_settings());
    let clock = machine.clock();
    let opening = machine
        .spawn_blocking(move || Store::open_with_clock(&folder, &settings, clock))
        .await;
    let opened = opening.map_err(|_| StoreThreadError::Gone("opening it panicked"))??;
    let damage = report_damage(opened.damage);
    let store = StoreThread::start(opened.store, event_bus.clone(), machine)
        .map_err(DaemonError::NoThread)?;
    Ok((store, damage))
}

/// Starts the tasks of the devices and of the store's upkeep.
fn start_tasks(
    config: &DaemonConfig,
    devices: &Arc<Devices>,
    context: Context,
    event_bus: &EventBus,
) {
    // Subscribed before the first event is published.
    devices.spawn(event_log::run(context.clone(), event_bus.subscribe()));
    devices.spawn(history::write_periodically(context.clone()));
    for device in &config.devices {
        let (name, address) = (device.name.clone(), device.address.clone());
        devices.start(name, address, &context, event_bus);
    }
    if config.discovers_usb() {
        let following = follow_usb(Arc::clone(devices), context.clone(), event_bus.clone());
        devices.spawn(following);
    }
    devices.spawn(store_watch::watch(context.clone()));
    devices.spawn(collect_garbage(context));
}

/// Logs damaged files that were set aside; returns them as text.
fn report_damage(files: Vec<DamagedFile>) -> Vec<String> {
    let mut damage = Vec::new();
    for file in files {
        let text = format!(
            "{} was damaged ({}), and is {} now",
            file.from.display(),
            printable(&file.why),
            file.to.display()
        );
        tracing::error!(text, "store: a damaged file was set aside");
        damage.push(text);
    }
    damage
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
