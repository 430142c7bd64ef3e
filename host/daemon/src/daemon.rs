//! The daemon as its users see it: devices, commands, leases, what happens.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ihd_store::{DeviceId, LookupRow, ResultFilter, ResultRow, Store, StoreError};
use tokio::sync::{Semaphore, broadcast, mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::OpenDevice;
use crate::auditor::Auditor;
use crate::board::Board;
use crate::config::Config;
use crate::device::{Context, Order, absent};
use crate::face::Face;
use crate::figures::{Figures, rss_bytes};
use crate::fleet::Trust;
use crate::fleet_view::FleetView;
use crate::history::{self, Seconds};
use crate::journalist;
use crate::learning::{Learner, LearnerError, LearnerSettings};
use crate::lease::{LeaseId, Taken};
use crate::live::LiveTap;
use crate::looks::{Ages, READERS};
use crate::machine::Machine;
use crate::model::{
    Command, CommandError, DeviceReport, Done, Lease, Notice, PotCurve, Record, RecordingFile,
    Trigger, What,
};
use crate::printable::printable;
use crate::recording::{list, name_of};
use crate::routing::route;
use crate::store_thread::{StoreThread, StoreTrouble};
use crate::store_watch;
use crate::supervisor::{Devices, Handle, follow_usb};
use crate::switching_off::switch_off;

/// How long a command may take, whatever the device does.
const COMMAND_WITHIN: Duration = Duration::from_secs(15);

/// Between two looks at what the store may delete.
const GARBAGE_EVERY: Duration = Duration::from_secs(600);

/// Outcomes of learning that may wait for the store.
const LEARNED: usize = 64;

/// How long the threads that learn have for the window that each is at.
const LEARNED_WITHIN: Duration = Duration::from_secs(10);

/// Longest name of a holder.
const LONGEST_HOLDER: usize = 128;

/// Why the daemon cannot start, or cannot answer.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// The store.
    #[error(transparent)]
    Store(#[from] ihd_store::StoreError),
    /// The store's thread.
    #[error(transparent)]
    StoreThread(#[from] StoreTrouble),
    /// No thread for the store.
    #[error("no thread could be started for the store: {0}")]
    NoThread(std::io::Error),
    /// No thread for learning.
    #[error(transparent)]
    Learner(#[from] LearnerError),
    /// A value of the configuration.
    #[error("the configuration: {0}")]
    Config(String),
    /// No such device.
    #[error("there is no device {0:?}")]
    NoDevice(String),
    /// The folder of recordings.
    #[error("the recordings in {}: {source}", folder.display())]
    Recordings {
        /// The folder.
        folder: PathBuf,
        /// What the operating system reports.
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
    board: Board,
    store: StoreThread,
    auditor: Auditor,
    recordings: PathBuf,
    /// Of the store, for those who read it.
    pub(crate) folder: PathBuf,
    pub(crate) readers: Semaphore,
    pub(crate) devices: Arc<Devices>,
    /// What devices did and the store does not know yet.
    pub(crate) seconds: Arc<Seconds>,
    /// Of the cells of each device's lookup.
    pub(crate) ages: Mutex<BTreeMap<String, Ages>>,
    /// What is known of the fleet, where this is an edge of one.
    pub(crate) fleet: FleetView,
    learner: Mutex<Option<Arc<Learner>>>,
    pub(crate) trust: Arc<Trust>,
    routing: Mutex<Option<JoinHandle<()>>>,
    stop: watch::Sender<bool>,
    began: Instant,
    /// Set aside at the start, told to whoever asks.
    damage: Mutex<Vec<String>>,
}

impl Daemon {
    /// Opens the store and starts a task for each device. Heats nothing.
    ///
    /// # Errors
    /// [`DaemonError`] where there is no store, or another process has it.
    pub async fn start(config: Config, open: Arc<OpenDevice>) -> Result<Self, DaemonError> {
        Self::start_on(Machine::default(), config, open).await
    }

    /// The wall's clock, in milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        self.inner.machine.now_ms()
    }

    /// As [`Daemon::start`], on this machine.
    ///
    /// # Errors
    /// As [`Daemon::start`].
    pub(crate) async fn start_on(
        machine: Machine,
        config: Config,
        open: Arc<OpenDevice>,
    ) -> Result<Self, DaemonError> {
        let board = Board::new(machine.clone());
        let network = config.network().map_err(DaemonError::Config)?;
        let (folder, settings) = (config.store.clone(), config.store_settings());
        let clock = machine.clock();
        let opening = machine
            .spawn_blocking(move || Store::open_with_clock(&folder, &settings, clock))
            .await;
        let opened = opening.map_err(|_| StoreTrouble::Gone("opening it panicked"))??;
        let mut damage = Vec::new();
        for found in opened.damage {
            let text = format!(
                "{} was damaged ({}), and is {} now",
                found.from.display(),
                printable(&found.why),
                found.to.display()
            );
            tracing::error!(text, "store: a damaged file was set aside");
            damage.push(text);
        }
        let store = StoreThread::start(opened.store, board.clone(), &machine)
            .map_err(DaemonError::NoThread)?;
        let (stop, stopped) = watch::channel(false);
        let (outcomes, learned) = mpsc::channel(LEARNED);
        let settings = LearnerSettings {
            threads: config.learning.threads,
            queue: config.learning.queue,
            network,
        };
        let learner = Arc::new(Learner::start_on(&machine, settings, outcomes)?);
        let seconds = Arc::new(Seconds::default());
        let trust = Arc::new(Trust::new(config.fleet.is_some()));
        let recordings = config.store.join("recordings");
        let auditor = Auditor::start(store.clone(), stopped.clone());
        let context = Context {
            machine: machine.clone(),
            store: store.clone(),
            seconds: Arc::clone(&seconds),
            learner: Arc::clone(&learner),
            trust: Arc::clone(&trust),
            open,
            recordings: recordings.clone(),
            stop: stopped,
        };
        let devices = Arc::new(Devices::default());
        // Before the first notice.
        devices.beside(journalist::take_down(context.clone(), board.watch()));
        devices.beside(history::keep(context.clone()));
        for device in &config.devices {
            let (name, address) = (device.name.clone(), device.address.clone());
            devices.start(name, address, &context, &board);
        }
        if config.discovers_usb() {
            let following = follow_usb(Arc::clone(&devices), context.clone(), board.clone());
            devices.beside(following);
        }
        devices.beside(store_watch::watch(context.clone()));
        devices.beside(keep_tidy(context));
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
                board,
                store,
                auditor,
                recordings,
                folder: config.store,
                readers: Semaphore::new(READERS),
                devices,
                seconds,
                ages: Mutex::default(),
                fleet: FleetView::default(),
                learner: Mutex::new(Some(learner)),
                trust,
                routing: Mutex::new(Some(routing)),
                stop,
                began: Instant::now(),
                damage: Mutex::new(damage),
            }),
        })
    }

    /// Every device, by name.
    pub fn devices(&self) -> Vec<DeviceReport> {
        let all = self.inner.devices.all();
        all.iter().map(|handle| handle.face.report()).collect()
    }

    /// The device of this name.
    pub fn device(&self, name: &str) -> Option<DeviceReport> {
        Some(self.inner.devices.get(name)?.face.report())
    }

    /// How warm the pot on the device of this name is, over the last hour.
    pub fn pot_curve(&self, name: &str) -> Option<PotCurve> {
        Some(self.inner.devices.get(name)?.face.pot_curve().clone())
    }

    /// Who learns; none once the daemon stops.
    pub(crate) fn learner(&self) -> Option<Arc<Learner>> {
        lock(&self.inner.learner).clone()
    }

    pub(crate) fn handle_of(&self, name: &str) -> Option<Handle> {
        self.inner.devices.get(name)
    }

    /// Runs `f` with the store.
    pub(crate) async fn in_store<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreTrouble> {
        self.inner.store.run(f).await
    }

    fn handle(&self, name: &str) -> Result<Handle, CommandError> {
        let found = self.handle_of(name);
        found.ok_or_else(|| CommandError::NoDevice {
            name: printable(name),
        })
    }

    /// Carries out a command. All but [`Command::Off`] and recordings need the lease: one that is free is taken by the command,
    /// for as long as it takes, and for [`crate::lease::LEASE_S`] where it heats. [`Command::Off`] waits for no other command, and
    /// what was asked for before it heats no more. The audit is written behind the answer.
    ///
    /// # Errors
    /// [`CommandError`].
    pub async fn command(
        &self,
        device: &str,
        holder: &str,
        command: Command,
    ) -> Result<Done, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let text = words(&command);
        let outcome = self.carry_out(&handle, &holder, command).await;
        let said = match &outcome {
            Ok(done) => done.text.clone(),
            Err(error) => error.to_string(),
        };
        let ok = outcome.is_ok();
        tracing::info!(
            device = handle.face.name,
            holder,
            command = text,
            ok,
            said,
            "command"
        );
        handle.face.tell(What::Command {
            holder: holder.clone(),
            text: text.clone(),
            ok,
        });
        let auditor = &self.inner.auditor;
        auditor.take(&handle.face, holder, text, said);
        outcome
    }

    async fn carry_out(
        &self,
        handle: &Handle,
        holder: &str,
        command: Command,
    ) -> Result<Done, CommandError> {
        let face = &handle.face;
        let lease = match command {
            Command::Off => return self.off(handle).await,
            // Who records looks, whoever commands.
            Command::RecordStart(_) | Command::RecordStop => None,
            _ => Some(self.borrow_lease(face, holder)?),
        };
        let outcome = match command {
            Command::Power { power_w: 0 } => self.off(handle).await,
            _ => self.order(handle, command, lease).await,
        };
        if lease.is_some_and(|id| face.lock().lease.end_command(id)) {
            self.tell_lease(face, "", "");
        }
        outcome
    }

    /// Has the device's task carry out a command.
    async fn order(
        &self,
        handle: &Handle,
        command: Command,
        lease: Option<LeaseId>,
    ) -> Result<Done, CommandError> {
        let (answer, answered) = oneshot::channel();
        let order = Order::Command {
            command,
            lease,
            answer,
        };
        let outcome = tokio::time::timeout(COMMAND_WITHIN, async {
            handle.orders.send(order).await.ok()?;
            answered.await.ok()
        });
        match outcome.await {
            Ok(Some(outcome)) => outcome,
            // The device's task has panicked, or is ending.
            Ok(None) => Err(CommandError::Failed {
                why: format!(
                    "{}: the command was not carried out: its task ended",
                    handle.face.name
                ),
            }),
            Err(_) => Err(not_in_time(&handle.face)),
        }
    }

    /// Switches off at once, whatever the device's task and its link are at, and voids what was asked for before.
    async fn off(&self, handle: &Handle) -> Result<Done, CommandError> {
        let face = &handle.face;
        let client = {
            let mut inner = face.lock();
            inner.lease.off();
            inner.sweep_left_w.clear();
            inner.client.clone()
        };
        let client = client.ok_or_else(|| absent(face))?;
        let off = tokio::time::timeout(COMMAND_WITHIN, switch_off(face, &client));
        let off = off.await.map_err(|_| not_in_time(face))?;
        // Until the device confirms, its task goes on trying.
        off.map_err(|error| CommandError::Refused {
            name: face.name.clone(),
            why: printable(&error.to_string()),
        })?;
        Ok(Done {
            text: "off".to_owned(),
            file: None,
        })
    }

    /// Takes the lease or renews it. With `force` it is taken from whoever has it, who is told, and whose
    /// heating ends.
    ///
    /// # Errors
    /// [`CommandError::Leased`] where another has it.
    pub async fn take_lease(
        &self,
        device: &str,
        holder: &str,
        force: bool,
    ) -> Result<Lease, CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let face = &handle.face;
        let taken = face.lock().lease.take(&holder, force, Instant::now());
        let taken = taken.map_err(|lease| leased(face, lease))?;
        self.tell_grant(face, &holder, &taken);
        if let Taken::From(other) = taken {
            let why = format!("{holder} has taken the lease from {other}");
            tracing::warn!(device = face.name, "{why}");
            let command = "take-lease --force".to_owned();
            let auditor = &self.inner.auditor;
            auditor.take(face, holder.clone(), command, why.clone());
            self.end_heating(&handle, why).await;
        }
        let now = Instant::now();
        let lease = face.lock().lease.current(now);
        lease.ok_or_else(|| CommandError::Failed {
            why: format!("{}: the lease ran out meanwhile", face.name),
        })
    }

    /// The lease for one command: the holder's own, or one that is free.
    fn borrow_lease(&self, face: &Face, holder: &str) -> Result<LeaseId, CommandError> {
        let begun = face.lock().lease.begin_command(holder, Instant::now());
        let (id, taken) = begun.map_err(|lease| leased(face, lease))?;
        self.tell_grant(face, holder, &taken);
        Ok(id)
    }

    fn tell_grant(&self, face: &Face, holder: &str, taken: &Taken) {
        match taken {
            Taken::Renewed => {}
            Taken::New => self.tell_lease(face, holder, ""),
            Taken::From(other) => self.tell_lease(face, holder, other),
        }
    }

    fn tell_lease(&self, face: &Face, holder: &str, taken_from: &str) {
        face.tell(What::Lease {
            holder: holder.to_owned(),
            taken_from: taken_from.to_owned(),
            why: String::new(),
        });
    }

    /// Gives the lease back; what was asked for under it is switched off.
    ///
    /// # Errors
    /// [`CommandError::Leased`] where another has it.
    pub async fn release_lease(&self, device: &str, holder: &str) -> Result<(), CommandError> {
        let handle = self.handle(device)?;
        let holder = holder_name(holder);
        let face = &handle.face;
        let now = Instant::now();
        let (released, other) = {
            let mut inner = face.lock();
            (inner.lease.release(&holder), inner.lease.current(now))
        };
        if let Some(other) = other {
            return Err(leased(face, other));
        }
        if released {
            self.tell_lease(face, "", "");
            self.end_heating(&handle, format!("{holder} has given the lease back"))
                .await;
        }
        Ok(())
    }

    /// Switches off what the lease that is over has left.
    async fn end_heating(&self, handle: &Handle, why: String) {
        let face = &handle.face;
        let client = {
            let inner = face.lock();
            let must_end = inner.lease.must_end(Instant::now());
            inner.client.clone().filter(|_| must_end)
        };
        let Some(client) = client else { return };
        tracing::info!(device = face.name, why, "off");
        let (name, address) = (face.name.clone(), face.address.clone());
        // What the store has no room for is in the log.
        let store = self.inner.store.writing_once(Record::Events);
        store.offer(move |store| {
            let device = store.device(&name, &address)?;
            store.event(Some(device), "off", &why)
        });
        let off = tokio::time::timeout(COMMAND_WITHIN, switch_off(face, &client));
        if !matches!(off.await, Ok(Ok(()))) {
            tracing::warn!(device = face.name, "was not switched off in time");
        }
    }

    /// Everything that happens, from now on.
    pub fn watch(&self) -> broadcast::Receiver<Arc<Notice>> {
        self.inner.board.watch()
    }

    /// What the devices do, from now on, at the pace of one watcher.
    pub fn live(&self) -> LiveTap {
        LiveTap::new(Arc::clone(&self.inner.devices))
    }

    /// The daemon in numbers.
    pub fn figures(&self) -> Figures {
        let learner = self.learner();
        Figures {
            learner: learner.map(|l| l.figures()).unwrap_or_default(),
            devices: self.inner.devices.all().len(),
            up_s: self.inner.began.elapsed().as_secs_f64(),
            rss_bytes: rss_bytes(),
            audit_is_well: self.inner.auditor.is_well(),
            audits_lost: self.inner.auditor.lost(),
            ..Figures::of_store(&self.inner.store)
        }
    }

    /// Files of the store that were found damaged at the start and set aside, in words.
    pub fn damage(&self) -> Vec<String> {
        lock(&self.inner.damage).clone()
    }

    /// Results, newest first.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn results(&self, filter: ResultFilter) -> Result<Vec<ResultRow>, DaemonError> {
        let results = self.inner.store.run(move |store| store.results(&filter));
        Ok(results.await?)
    }

    /// Every lookup of a device, oldest first.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or what the store reports.
    pub async fn lookups(&self, device: &str) -> Result<Vec<LookupRow>, DaemonError> {
        let handle = self.inner.devices.get(device);
        let handle = handle.ok_or_else(|| DaemonError::NoDevice(printable(device)))?;
        let (name, address) = (handle.face.name.clone(), handle.face.address.clone());
        let lookups = self.inner.store.run(move |store| {
            let device: DeviceId = store.device(&name, &address)?;
            store.lookups(device)
        });
        Ok(lookups.await?)
    }

    /// The folder that devices are recorded into.
    pub fn recordings_folder(&self) -> &Path {
        &self.inner.recordings
    }

    /// The recordings that there are, newest first.
    ///
    /// # Errors
    /// [`DaemonError::Recordings`] where their folder cannot be read.
    pub async fn recordings(&self) -> Result<Vec<RecordingFile>, DaemonError> {
        let handles = self.inner.devices.all();
        let devices: Vec<String> = handles.iter().map(|h| h.face.name.clone()).collect();
        let writing = handles.iter().flat_map(|h| h.face.recorder.incomplete());
        let writing: Vec<String> = writing.map(|path| name_of(&path)).collect();
        let folder = self.inner.recordings.clone();
        let failed = |source| DaemonError::Recordings {
            folder: self.inner.recordings.clone(),
            source,
        };
        let listed = tokio::task::spawn_blocking(move || list(&folder, &devices, &writing)).await;
        listed.map_err(|e| failed(e.into()))?.map_err(failed)
    }

    /// Copies the store while it is used.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn backup(&self, to: PathBuf) -> Result<(), DaemonError> {
        // Beside the store's thread, which windows wait for.
        let from = self.inner.folder.clone();
        let backup = tokio::task::spawn_blocking(move || ihd_store::backup(&from, &to)).await;
        Ok(backup.map_err(|_| StoreTrouble::Gone("the backup panicked"))??)
    }

    /// Switches off what was asked for through the daemon, stores what is under way, closes the store.
    pub async fn stop(self) {
        self.inner.stop.send_replace(true);
        self.inner.devices.ended().await;
        self.inner.auditor.close().await;
        let now_ms = self.inner.machine.now_ms();
        history::write(&self.inner.seconds, &self.inner.store, now_ms, true).await;
        // Windows under way hold the learner.
        self.inner.store.idle().await;
        drop(lock(&self.inner.learner).take());
        let routing = lock(&self.inner.routing).take();
        if let Some(routing) = routing {
            // It ends when the threads that learn have, with the window that each is at.
            let _ = tokio::time::timeout(LEARNED_WITHIN, routing).await;
        }
        self.inner.store.close().await;
    }
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every change is complete in itself.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Deletes what the store need not keep any more.
async fn keep_tidy(context: Context) {
    loop {
        // The store's trouble is told by its thread.
        let store = context.store.writing(Record::State);
        let _ = store.run(Store::collect_garbage).await;
        tokio::select! {
            biased;
            () = context.stopping() => return,
            () = tokio::time::sleep(GARBAGE_EVERY) => {}
        }
    }
}

fn not_in_time(face: &Face) -> CommandError {
    CommandError::Failed {
        why: format!(
            "{}: the command was not carried out within {} s",
            face.name,
            COMMAND_WITHIN.as_secs()
        ),
    }
}

fn leased(face: &Face, lease: Lease) -> CommandError {
    CommandError::Leased {
        name: face.name.clone(),
        holder: lease.holder,
        expires_in_s: lease.expires_in_s,
    }
}

/// Names come over the API: they end in logs and terminals.
fn holder_name(holder: &str) -> String {
    let name: String = printable(holder).chars().take(LONGEST_HOLDER).collect();
    match name.trim() {
        "" => "somebody".to_owned(),
        name => name.to_owned(),
    }
}

/// A command in words, for logs and the audit.
fn words(command: &Command) -> String {
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
