//! Who is next: one window of a device at a time, in their order, the devices in turn.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_map::library::Library;
use ihd_train::Learning;

use super::outcome::Task;

/// A window that was dropped from the queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dropped {
    /// The device's name.
    pub device: String,
    /// Its boot.
    pub boot: u32,
    /// The window's number.
    pub seq: u32,
}

/// What a device's learning is told between two windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Note {
    /// The device uses this version.
    DeviceHas(u32),
    /// It has made a lookup its own.
    Accepted(u32),
    /// It has refused one.
    Refused(u32),
    /// What was learned is forgotten.
    Forget,
}

impl Note {
    /// Tells it.
    pub fn tell(self, learning: &mut Learning) {
        match self {
            Self::DeviceHas(version) => learning.device_has(version),
            Self::Accepted(version) => learning.accepted(version),
            Self::Refused(version) => learning.refused(version),
            Self::Forget => learning.forget(),
        }
    }
}

/// What was learned of a device, and when that went to the store.
#[derive(Clone)]
pub struct Known {
    /// What was learned.
    pub learning: Learning,
    saved: Instant,
    curves_saved: usize,
}

impl Known {
    fn new(learning: Learning) -> Self {
        Self {
            saved: Instant::now(),
            curves_saved: learning.curves(),
            learning,
        }
    }

    /// The bytes for the store, where something new was learned, or nothing was stored for `every`.
    pub fn take_due_save(&mut self, is_news: bool, every: Duration) -> Option<Vec<u8>> {
        let curves = self.learning.curves();
        if !is_news && curves == self.curves_saved && self.saved.elapsed() < every {
            return None;
        }
        (self.saved, self.curves_saved) = (Instant::now(), curves);
        Some(self.learning.to_bytes())
    }
}

/// A device's windows, and what they have taught.
struct Slot {
    /// None while a thread has it.
    known: Option<Box<Known>>,
    /// Boot and number of the window that a thread has.
    studied: Option<(u32, u32)>,
    /// What the sensors' windows have shown, of before a thread took what is known.
    skew_s: Option<f64>,
    notes: Vec<Note>,
    /// Each with its place in the order in which all came.
    tasks: VecDeque<(u64, Task)>,
    unlearned: u64,
}

fn skew_s(known: &Known) -> Option<f64> {
    known
        .learning
        .correction()
        .map(|correction| correction.skew_s)
}

/// The windows that wait.
#[derive(Default)]
pub struct Queue {
    devices: HashMap<String, Slot>,
    /// Devices with a window that can be learned now; the one whose turn is longest ago is the first.
    turns: VecDeque<String>,
    waiting: usize,
    came: u64,
    /// Pots that other hobs know.
    library: Option<Arc<Library>>,
}

impl Queue {
    /// Windows that wait.
    pub fn waiting(&self) -> usize {
        self.waiting
    }

    /// A device that is new, or begins anew: what waits of it stays.
    pub fn put(&mut self, device: &str, learning: Learning) {
        let mut known = Known::new(learning);
        if let Some(library) = &self.library {
            known.learning.use_library(Arc::clone(library));
        }
        let slot = self.slot(device);
        slot.notes.clear();
        slot.known = Some(Box::new(known));
    }

    /// Whether the device is known.
    pub fn knows(&self, device: &str) -> bool {
        self.devices.contains_key(device)
    }

    /// Windows of a device that were dropped.
    pub fn unlearned(&self, device: &str) -> u64 {
        self.devices.get(device).map_or(0, |slot| slot.unlearned)
    }

    /// Tells a device's learning something, now or after the window that it is at.
    pub fn note(&mut self, device: &str, note: Note) {
        if let Some(slot) = self.devices.get_mut(device) {
            match &mut slot.known {
                Some(known) => note.tell(&mut known.learning),
                None => slot.notes.push(note),
            }
        }
    }

    /// A device's learning, while no thread has it.
    pub fn learning(&self, device: &str) -> Option<&Learning> {
        Some(&self.devices.get(device)?.known.as_ref()?.learning)
    }

    /// The skew in seconds that is to be taken out of a device's windows.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        let slot = self.devices.get(device)?;
        slot.known.as_deref().map_or(slot.skew_s, skew_s)
    }

    fn slot(&mut self, device: &str) -> &mut Slot {
        self.devices
            .entry(device.to_owned())
            .or_insert_with(|| Slot {
                known: None,
                studied: None,
                skew_s: None,
                notes: Vec::new(),
                tasks: VecDeque::new(),
                unlearned: 0,
            })
    }

    /// Adds a window of a known device. Beyond `limit` windows in all, the oldest of the device that has most
    /// of them waiting is dropped: so that one that sends much costs the others nothing. With devices alike
    /// that is the oldest of all.
    pub fn push(&mut self, task: Task, limit: usize) -> Option<Dropped> {
        let device = task.device.clone();
        let came = self.came;
        let slot = self.devices.get_mut(&device)?;
        self.came += 1;
        let was_idle = slot.known.is_some() && slot.tasks.is_empty();
        slot.tasks.push_back((came, task));
        self.waiting += 1;
        if was_idle {
            self.turns.push_back(device);
        }
        if self.waiting <= limit {
            return None;
        }
        self.drop_one()
    }

    fn drop_one(&mut self) -> Option<Dropped> {
        let most = self.devices.iter_mut().max_by_key(|(_, slot)| {
            let oldest = slot.tasks.front().map_or(u64::MAX, |(came, _)| *came);
            (slot.tasks.len(), std::cmp::Reverse(oldest))
        });
        let (name, slot) = most?;
        let (_, task) = slot.tasks.pop_front()?;
        slot.unlearned += 1;
        self.waiting -= 1;
        if slot.tasks.is_empty() {
            let name = name.clone();
            self.turns.retain(|turn| *turn != name);
        }
        Some(Dropped {
            device: task.device,
            boot: task.boot,
            seq: task.work.seq(),
        })
    }

    /// The next window, and what its device has learned; the device is left alone until [`Queue::back`].
    pub fn next(&mut self) -> Option<(Task, Box<Known>)> {
        let device = self.turns.pop_front()?;
        let slot = self.devices.get_mut(&device)?;
        let known = slot.known.take()?;
        slot.skew_s = skew_s(&known);
        let Some((_, task)) = slot.tasks.pop_front() else {
            slot.known = Some(known);
            return None;
        };
        slot.studied = Some((task.boot, task.work.seq()));
        self.waiting -= 1;
        Some((task, known))
    }

    /// What a device was told since [`Queue::next`].
    pub fn take_notes(&mut self, device: &str) -> Vec<Note> {
        let slot = self.devices.get_mut(device);
        slot.map(|slot| std::mem::take(&mut slot.notes))
            .unwrap_or_default()
    }

    /// A device's learning, back from a thread: its next window may be learned.
    pub fn back(&mut self, device: &str, mut known: Box<Known>) {
        for note in self.take_notes(device) {
            note.tell(&mut known.learning);
        }
        if let Some(library) = &self.library {
            known.learning.use_library(Arc::clone(library));
        }
        if let Some(slot) = self.devices.get_mut(device) {
            slot.studied = None;
            // Put anew meanwhile, that one counts.
            slot.known.get_or_insert(known);
            if !slot.tasks.is_empty() && !self.turns.iter().any(|turn| turn == device) {
                self.turns.push_back(device.to_owned());
            }
        }
    }

    /// Pots that other hobs know; false where they are those of before. A device whose window is being learned gets them behind it.
    pub fn use_library(&mut self, library: Arc<Library>) -> bool {
        if self.library.as_ref() == Some(&library) {
            return false;
        }
        for slot in self.devices.values_mut() {
            if let Some(known) = &mut slot.known {
                known.learning.use_library(Arc::clone(&library));
            }
        }
        self.library = Some(library);
        true
    }

    /// Whether this window waits, or a thread has it.
    pub fn holds(&self, device: &str, boot: u32, seq: u32) -> bool {
        let slot = self.devices.get(device);
        slot.is_some_and(|slot| {
            let mut tasks = slot.tasks.iter();
            slot.studied == Some((boot, seq))
                || tasks.any(|(_, task)| task.boot == boot && task.work.seq() == seq)
        })
    }

    /// Drops all that waits; returns how many.
    pub fn clear(&mut self) -> usize {
        for slot in self.devices.values_mut() {
            slot.unlearned += slot.tasks.len() as u64;
            slot.tasks.clear();
        }
        self.turns.clear();
        std::mem::take(&mut self.waiting)
    }
}
