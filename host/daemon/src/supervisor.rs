//! Supervision of the device tasks: start, restart after a panic, and tasks for boards plugged into USB.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_capture::recording::{RecordingOptions, RecordingSession, RecordingStatus, name_of};
use ihd_link::{DeviceSpec, usb};
use ihd_model::{DeviceState, EventKind, RecordingPhase};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::config::Address;
use crate::context::Context;
use crate::device::{DeviceRequest, DeviceTask};
use crate::device_record::DeviceRecord;
use crate::event_bus::EventBus;
use crate::locking::lock;
use crate::printable::printable;
use crate::recording::{file_name, free_bytes};
use crate::switching_off::switch_off;

/// Capacity of a device task's request queue.
const REQUESTS: usize = 16;

/// Pause before the restart of a device task that panicked.
const RESTART_DELAY: Duration = Duration::from_secs(1);

/// Time limit for switching off after a panic of the device's task.
const OFF_TIMEOUT: Duration = Duration::from_secs(5);

/// Period of listing the boards on USB.
const USB_PERIOD: Duration = Duration::from_secs(1);

/// Shared record of a device and the sender to its task.
#[derive(Clone)]
pub struct Handle {
    /// Shared record of the device.
    pub record: Arc<DeviceRecord>,
    /// Sender of requests to its task.
    pub requests: mpsc::Sender<DeviceRequest>,
}

/// Registry of all devices and tasks.
#[derive(Default)]
pub struct Devices {
    handles: Mutex<BTreeMap<String, Handle>>,
    /// Recordings, armed or under way, of boards that are unplugged, by the device's name.
    parked: Mutex<BTreeMap<String, RecordingSession>>,
    tasks: Mutex<Vec<JoinHandle<()>>>,
}

impl Devices {
    /// Returns the device of this name; `None` if there is none.
    pub fn get(&self, name: &str) -> Option<Handle> {
        lock(&self.handles).get(name).cloned()
    }

    /// Returns all devices, sorted by name.
    pub fn all(&self) -> Vec<Handle> {
        lock(&self.handles).values().cloned().collect()
    }

    /// Starts the task of a device.
    pub fn start(&self, name: String, address: Address, context: &Context, event_bus: &EventBus) {
        let (requests, received) = mpsc::channel(REQUESTS);
        let parked = self.take_parked(&name);
        let recorder = parked.unwrap_or_else(|| recorder(&name, context, event_bus));
        let record = DeviceRecord::new(
            name.clone(),
            address.to_string(),
            event_bus.clone(),
            recorder,
        );
        let record = Arc::new(record);
        let handle = Handle {
            record: Arc::clone(&record),
            requests,
        };
        lock(&self.handles).insert(name, handle);
        let task = DeviceTask {
            record,
            address,
            context: context.clone(),
        };
        let record = Arc::clone(&task.record);
        let (task, received) = (Arc::new(task), Arc::new(tokio::sync::Mutex::new(received)));
        let running = tokio::spawn(keep_running(record, move || {
            let (task, requests) = (Arc::clone(&task), Arc::clone(&received));
            async move { task.run(&mut *requests.lock().await).await }
        }));
        let mut tasks = lock(&self.tasks);
        tasks.retain(|task| !task.is_finished());
        tasks.push(running);
    }

    /// Spawns a further task, which [`Devices::join`] waits for.
    pub fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        lock(&self.tasks).push(tokio::spawn(task));
    }

    /// Removes a device that is unplugged; its task ends by its own stop signal. A recording, armed or under way, waits until it is plugged in again.
    fn forget(&self, name: &str) {
        let Some(Handle { record, .. }) = lock(&self.handles).remove(name) else {
            return;
        };
        record.is_unplugged.store(true, Ordering::Relaxed);
        record.recorder.disconnected();
        if record.recorder.active().is_some() {
            lock(&self.parked).insert(name.to_owned(), record.recorder.clone());
        }
    }

    /// Takes the recording of a board that was unplugged; `None` if there is none.
    fn take_parked(&self, name: &str) -> Option<RecordingSession> {
        lock(&self.parked).remove(name)
    }

    /// Ends recordings of unplugged boards whose time is over.
    fn tick_parked(&self) {
        lock(&self.parked).retain(|_, recorder| {
            recorder.tick();
            recorder.active().is_some()
        });
    }

    /// Waits until all tasks have ended.
    pub async fn join(&self) {
        let tasks = std::mem::take(&mut *lock(&self.tasks));
        for task in tasks {
            // Panics are logged where they happen.
            let _ = task.await;
        }
    }
}

/// Creates the recorder of a device: files in the store's folder, status to the log and the event bus.
fn recorder(device: &str, context: &Context, event_bus: &EventBus) -> RecordingSession {
    let (folder, name) = (context.recordings.clone(), device.to_owned());
    let machine = context.machine.clone();
    let named = move |_| folder.join(file_name(&name, machine.now_ms()));
    let (device, event_bus) = (device.to_owned(), event_bus.clone());
    let options = RecordingOptions {
        free_bytes: Some(free_bytes),
        ..RecordingOptions::default()
    };
    let publish = move |RecordingStatus { phase, text, file }| {
        let (text, file) = (printable(&text), file.as_deref().map(name_of));
        match phase {
            RecordingPhase::Failed => tracing::warn!(device, file, text, "recording"),
            _ => tracing::info!(device, file, text, "recording"),
        }
        event_bus.publish(&device, EventKind::Recording { phase, text, file });
    };
    RecordingSession::with_options(options, named, publish)
}

/// Runs a device's task and, after a panic, switches the hob off and restarts the task.
async fn keep_running<F>(record: Arc<DeviceRecord>, run: impl Fn() -> F)
where
    F: Future<Output = ()> + Send + 'static,
{
    loop {
        let Err(panicked) = tokio::spawn(run()).await else {
            return;
        };
        recover_from_panic(&record, &panicked.to_string()).await;
        tokio::time::sleep(RESTART_DELAY).await;
    }
}

/// Switches the hob off after a panic of its task, if the daemon had requested power.
async fn recover_from_panic(record: &Arc<DeviceRecord>, why: &str) {
    let why = printable(why);
    record.recorder.disconnected();
    tracing::error!(
        device = record.name,
        why,
        "its task panicked: this is a fault of this program; it begins anew"
    );
    let (client, asked_w) = {
        let mut inner = record.lock();
        inner.sweep_left_w.clear();
        (inner.client.take(), inner.lease.asked_w())
    };
    if let Some(client) = client
        && asked_w > 0
    {
        let _ = tokio::time::timeout(OFF_TIMEOUT, switch_off(record, &client)).await;
    }
    record.enter(
        DeviceState::Searching,
        "its task failed: this is a fault of this program, in the log; it begins anew",
    );
}

/// Starts a task for each board on USB that is not a configured device, and ends it when the board is unplugged.
pub async fn follow_usb(devices: Arc<Devices>, context: Context, event_bus: EventBus) {
    let mut plugged: BTreeMap<String, watch::Sender<bool>> = BTreeMap::new();
    let mut is_failing = false;
    loop {
        // Listing blocks for a moment.
        let listed = tokio::task::spawn_blocking(usb::boards).await;
        match listed {
            Ok(Ok(boards)) => {
                is_failing = false;
                let serials: Vec<_> = boards.into_iter().map(|b| b.serial).collect();
                unplug(&devices, &mut plugged, &serials);
                devices.tick_parked();
                for serial in serials {
                    plug(&devices, &mut plugged, serial, &context, &event_bus);
                }
            }
            Ok(Err(error)) if !is_failing => {
                is_failing = true;
                tracing::warn!(%error, "USB");
            }
            _ => {}
        }
        tokio::select! {
            () = context.stopping() => break,
            () = tokio::time::sleep(USB_PERIOD) => {}
        }
    }
    for stop in plugged.values() {
        stop.send_replace(true);
    }
}

fn unplug(
    devices: &Devices,
    plugged: &mut BTreeMap<String, watch::Sender<bool>>,
    serials: &[String],
) {
    plugged.retain(|serial, stop| {
        let stays = serials.contains(serial);
        if !stays {
            tracing::info!(device = usb_name(serial), "unplugged");
            devices.forget(&usb_name(serial));
            stop.send_replace(true);
        }
        stays
    });
}

fn plug(
    devices: &Devices,
    plugged: &mut BTreeMap<String, watch::Sender<bool>>,
    serial: String,
    context: &Context,
    event_bus: &EventBus,
) {
    let spec = DeviceSpec::Usb(Some(serial.clone()));
    let is_configured = devices
        .all()
        .iter()
        .any(|handle| handle.record.address == printable(&spec.to_string()));
    if plugged.contains_key(&serial) || is_configured {
        return;
    }
    let (stop, stopped) = watch::channel(false);
    let context = Context {
        stop: stopped,
        ..context.clone()
    };
    tracing::info!(device = usb_name(&serial), "plugged in");
    devices.start(usb_name(&serial), spec.into(), &context, event_bus);
    plugged.insert(serial, stop);
}

fn usb_name(serial: &str) -> String {
    printable(&format!("usb:{serial}"))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU32;

    use ihd_link::AsyncClient;
    use ihd_model::{RecordSettings, Trigger};
    use ihd_sim::hob::{HobConfig, SimHob};
    use ihd_sim::transport::SharedHob;
    use tokio::time::Instant;

    use super::*;

    #[test]
    fn an_armed_recording_waits_for_a_board_that_is_unplugged() {
        let folder = tempfile::tempdir().unwrap();
        let (path, phases) = (folder.path().join("a.mcap"), Arc::new(Mutex::default()));
        let told: Arc<Mutex<Vec<RecordingPhase>>> = Arc::clone(&phases);
        let recorder = RecordingSession::new(
            move |_| path.clone(),
            move |status: RecordingStatus| lock(&told).push(status.phase),
        );
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let client = ihd_link::Client::connect(Box::new(hob)).unwrap();
        let at = client.clock();
        let sink = recorder.connected(client.hello(), client.front_end(), at);
        let armed = RecordSettings {
            trigger: Trigger::Fault,
            ..RecordSettings::default()
        };
        recorder.start(armed, at).unwrap();
        let name = usb_name("12");
        let record =
            DeviceRecord::new(name.clone(), "usb:12".into(), EventBus::default(), recorder);
        let (record, requests) = (Arc::new(record), mpsc::channel(1).0);
        let handle = Handle {
            record: Arc::clone(&record),
            requests,
        };
        let devices = Devices::default();
        lock(&devices.handles).insert(name.clone(), handle);
        let mut plugged = BTreeMap::from([("12".to_owned(), watch::channel(false).0)]);
        unplug(&devices, &mut plugged, &[]);
        devices.tick_parked();
        assert!(devices.get(&name).is_none() && plugged.is_empty());
        assert!(record.is_unplugged.load(Ordering::Relaxed));
        drop((sink, record));
        // The board is plugged in again.
        let recorder = devices.take_parked(&name).expect("it is kept");
        assert_eq!(recorder.active().map(|now| now.settings), Some(armed));
        assert_eq!(*lock(&phases), [RecordingPhase::Armed]);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_task_that_panics_leaves_the_hob_off_and_runs_again() {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let plug = hob.clone();
        let (events, _coming) = mpsc::channel(16);
        let client = AsyncClient::connect(move || Ok(Box::new(plug)), events).await;
        let client = Arc::new(client.unwrap());
        client.with(|c| c.set_power(900)).await.unwrap().unwrap();
        let recorder = RecordingSession::new(|_| panic!("nothing is recorded"), |_| ());
        let record = DeviceRecord::new("a".into(), "sim".into(), EventBus::default(), recorder);
        let record = Arc::new(record);
        {
            let (now, mut inner) = (Instant::now(), record.lock());
            let (lease, _) = inner.lease.begin_command("somebody", now).unwrap();
            inner.lease.request_power(lease, 900, now).unwrap();
        }
        record.lock().client = Some(client);
        let runs = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&runs);
        keep_running(Arc::clone(&record), move || {
            let counted = Arc::clone(&counted);
            async move {
                assert!(
                    counted.fetch_add(1, Ordering::Relaxed) > 0,
                    "the first one fails"
                );
            }
        })
        .await;
        assert_eq!(runs.load(Ordering::Relaxed), 2);
        assert_eq!(hob.lock().housekeeping().control().asked_w(), 0);
        assert_eq!(record.lock().lease.asked_w(), 0);
        assert!(record.detail().contains("fault of this program"));
    }
}
