//! The tasks of all devices: started, watched, started again after a panic; and boards that come and go on
//! USB.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ihd_link::{DeviceSpec, usb};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::board::Board;
use crate::config::Address;
use crate::device::{Context, DeviceTask, Order};
use crate::face::Face;
use crate::model::{DeviceState, RecordingPhase, What};
use crate::printable::printable;
use crate::recording::{Recorder, Told, file_name, name_of};
use crate::switching_off::switch_off;

/// Orders that may wait for a device's task.
const ORDERS: usize = 16;

/// After a panic of a device's task.
const AFTER_PANIC: Duration = Duration::from_secs(1);

/// How long a device has to switch off after its task has panicked.
const OFF_WITHIN: Duration = Duration::from_secs(5);

/// Between two looks at USB.
const USB_EVERY: Duration = Duration::from_secs(1);

/// A device and the way to its task.
#[derive(Clone)]
pub struct Handle {
    /// The device as others see it.
    pub face: Arc<Face>,
    /// What its task is told.
    pub orders: mpsc::Sender<Order>,
}

/// All devices.
#[derive(Default)]
pub struct Devices {
    handles: Mutex<BTreeMap<String, Handle>>,
    tasks: Mutex<Vec<JoinHandle<()>>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every change is complete in itself.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Devices {
    /// The device of this name.
    pub fn get(&self, name: &str) -> Option<Handle> {
        lock(&self.handles).get(name).cloned()
    }

    /// All of them, by name.
    pub fn all(&self) -> Vec<Handle> {
        lock(&self.handles).values().cloned().collect()
    }

    /// Starts the task of a device.
    pub fn start(&self, name: String, address: Address, context: &Context, board: &Board) {
        let (orders, taken) = mpsc::channel(ORDERS);
        let recorder = recorder(&name, context, board);
        let face = Face::new(name.clone(), address.to_string(), board.clone(), recorder);
        let face = Arc::new(face);
        let handle = Handle {
            face: Arc::clone(&face),
            orders,
        };
        lock(&self.handles).insert(name, handle);
        let task = DeviceTask {
            face,
            address,
            context: context.clone(),
        };
        let face = Arc::clone(&task.face);
        let (task, taken) = (Arc::new(task), Arc::new(tokio::sync::Mutex::new(taken)));
        let watched = tokio::spawn(keep_running(face, move || {
            let (task, orders) = (Arc::clone(&task), Arc::clone(&taken));
            async move { task.run(&mut *orders.lock().await).await }
        }));
        let mut tasks = lock(&self.tasks);
        tasks.retain(|task| !task.is_finished());
        tasks.push(watched);
    }

    /// A task beside the devices', which ends with them.
    pub fn beside(&self, task: impl Future<Output = ()> + Send + 'static) {
        lock(&self.tasks).push(tokio::spawn(task));
    }

    /// Forgets a device; its task ends by itself.
    fn forget(&self, name: &str) {
        lock(&self.handles).remove(name);
    }

    /// Waits until all tasks have ended.
    pub async fn ended(&self) {
        let tasks = std::mem::take(&mut *lock(&self.tasks));
        for task in tasks {
            // Their panics are told where they happen.
            let _ = task.await;
        }
    }
}

/// The recorder of a device: into the store's folder, told to whoever watches and the log.
fn recorder(device: &str, context: &Context, board: &Board) -> Recorder {
    let (folder, name) = (context.recordings.clone(), device.to_owned());
    let machine = context.machine.clone();
    let named = move |_| folder.join(file_name(&name, machine.now_ms()));
    let (device, board) = (device.to_owned(), board.clone());
    Recorder::new(named, move |Told { phase, text, file }| {
        let (text, file) = (printable(&text), file.as_deref().map(name_of));
        match phase {
            RecordingPhase::Failed => tracing::warn!(device, file, text, "recording"),
            _ => tracing::info!(device, file, text, "recording"),
        }
        board.tell(&device, What::Recording { phase, text, file });
    })
}

/// Runs a device's task, and once more after a panic: the hob off first.
async fn keep_running<F>(face: Arc<Face>, run: impl Fn() -> F)
where
    F: Future<Output = ()> + Send + 'static,
{
    loop {
        let Err(panicked) = tokio::spawn(run()).await else {
            return;
        };
        after_panic(&face, &panicked.to_string()).await;
        tokio::time::sleep(AFTER_PANIC).await;
    }
}

/// The task of a device is gone: the hob is switched off where we had asked for power.
async fn after_panic(face: &Arc<Face>, why: &str) {
    let why = printable(why);
    face.recorder.disconnected();
    tracing::error!(
        device = face.name,
        why,
        "its task panicked: this is a fault of this program; it begins anew"
    );
    let (client, asked_w) = {
        let mut inner = face.lock();
        inner.sweep_left_w.clear();
        (inner.client.take(), inner.lease.asked_w())
    };
    if let Some(client) = client
        && asked_w > 0
    {
        let _ = tokio::time::timeout(OFF_WITHIN, switch_off(face, &client)).await;
    }
    face.enter(
        DeviceState::Searching,
        "its task failed: this is a fault of this program, in the log; it begins anew",
    );
}

/// Boards on USB that no configured device names: each gets a task when it appears, which ends when it is
/// unplugged.
pub async fn follow_usb(devices: Arc<Devices>, context: Context, board: Board) {
    let mut plugged: BTreeMap<String, watch::Sender<bool>> = BTreeMap::new();
    let mut complained = false;
    loop {
        // Listing blocks, for a moment.
        let listed = tokio::task::spawn_blocking(usb::boards).await;
        match listed {
            Ok(Ok(boards)) => {
                complained = false;
                let serials: Vec<_> = boards.into_iter().map(|b| b.serial).collect();
                unplug(&devices, &mut plugged, &serials);
                for serial in serials {
                    plug(&devices, &mut plugged, serial, &context, &board);
                }
            }
            Ok(Err(error)) if !complained => {
                complained = true;
                tracing::warn!(%error, "USB");
            }
            _ => {}
        }
        tokio::select! {
            () = context.stopping() => break,
            () = tokio::time::sleep(USB_EVERY) => {}
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
            stop.send_replace(true);
            devices.forget(&usb_name(serial));
        }
        stays
    });
}

fn plug(
    devices: &Devices,
    plugged: &mut BTreeMap<String, watch::Sender<bool>>,
    serial: String,
    context: &Context,
    board: &Board,
) {
    let spec = DeviceSpec::Usb(Some(serial.clone()));
    let is_configured = devices
        .all()
        .iter()
        .any(|handle| handle.face.address == printable(&spec.to_string()));
    if plugged.contains_key(&serial) || is_configured {
        return;
    }
    let (stop, stopped) = watch::channel(false);
    let context = Context {
        stop: stopped,
        ..context.clone()
    };
    tracing::info!(device = usb_name(&serial), "plugged in");
    devices.start(usb_name(&serial), spec.into(), &context, board);
    plugged.insert(serial, stop);
}

fn usb_name(serial: &str) -> String {
    printable(&format!("usb:{serial}"))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use ihd_link::AsyncClient;
    use ihd_sim::hob::{HobConfig, SimHob};
    use ihd_sim::transport::SharedHob;
    use tokio::time::Instant;

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_task_that_panics_leaves_the_hob_off_and_runs_again() {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let plug = hob.clone();
        let (events, _coming) = mpsc::channel(16);
        let client = AsyncClient::connect(move || Ok(Box::new(plug)), events).await;
        let client = Arc::new(client.unwrap());
        client.with(|c| c.set_power(900)).await.unwrap().unwrap();
        let recorder = Recorder::new(|_| panic!("nothing is recorded"), |_| ());
        let face = Face::new("a".into(), "sim".into(), Board::default(), recorder);
        let face = Arc::new(face);
        {
            let (now, mut inner) = (Instant::now(), face.lock());
            let (lease, _) = inner.lease.begin_command("somebody", now).unwrap();
            inner.lease.ask(lease, 900, now).unwrap();
        }
        face.lock().client = Some(client);
        let runs = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&runs);
        keep_running(Arc::clone(&face), move || {
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
        assert_eq!(face.lock().lease.asked_w(), 0);
        assert!(face.detail().contains("fault of this program"));
    }
}
