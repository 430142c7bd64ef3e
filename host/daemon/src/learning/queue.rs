//! Queue of windows: one window of a device at a time, in their order, the devices in turn.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_map::library::Library;
use ihd_train::Learning;

use super::job::LearnJob;

/// A window that was dropped from the queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DroppedWindow {
    /// Name of the device.
    pub device: String,
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window.
    pub seq: u32,
}

/// Event that is applied to a device's learning between two windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LearningEvent {
    /// The device uses the lookup of this version.
    DeviceVersion(u32),
    /// The device has accepted the lookup of this version.
    LookupAccepted(u32),
    /// The device has refused the lookup of this version.
    LookupRefused(u32),
    /// The device has this boot.
    Boot(u32),
    /// The load is to be forgotten.
    Forget,
    /// The device is another board: load and sensors are to be forgotten.
    Board,
}

impl LearningEvent {
    /// Applies the event.
    pub fn apply(self, learning: &mut Learning) {
        match self {
            Self::DeviceVersion(version) => learning.set_device_version(version),
            Self::LookupAccepted(version) => learning.lookup_accepted(version),
            Self::LookupRefused(version) => learning.lookup_refused(version),
            Self::Boot(boot) => learning.begin_boot(boot),
            Self::Forget => learning.forget(),
            Self::Board => learning.forget_board(),
        }
    }

    /// Returns `true` if lookups of before are not to reach the device.
    pub fn forgets(self) -> bool {
        matches!(self, Self::Forget | Self::Board)
    }
}

/// Learning of a device, with the time of its last save.
#[derive(Clone)]
pub struct DeviceLearning {
    /// The device's learning.
    pub learning: Learning,
    saved: Instant,
    curves_saved: usize,
    /// Reason for which a window gave no lookup, until one does; empty without one.
    no_lookup: String,
}

impl DeviceLearning {
    fn new(learning: Learning) -> Self {
        Self {
            saved: Instant::now(),
            curves_saved: learning.curve_count(),
            no_lookup: String::new(),
            learning,
        }
    }

    /// Keeps the reason for which a window gave no lookup; returns it if it is another than the one before.
    pub fn change_no_lookup(&mut self, why: String) -> Option<String> {
        let is_new = why != self.no_lookup;
        self.no_lookup.clone_from(&why);
        is_new.then_some(why)
    }

    /// Ends the reason: a window gave a lookup.
    pub fn clear_no_lookup(&mut self) {
        self.no_lookup.clear();
    }

    /// Returns the bytes for the store if the lookup or the number of curves has changed, or the last save is `every` ago.
    pub fn take_due_save(&mut self, lookup_changed: bool, every: Duration) -> Option<Vec<u8>> {
        let curves = self.learning.curve_count();
        if !lookup_changed && curves == self.curves_saved && self.saved.elapsed() < every {
            return None;
        }
        (self.saved, self.curves_saved) = (Instant::now(), curves);
        Some(self.learning.to_bytes())
    }
}

/// Queue and learning of one device.
struct Slot {
    /// `None` while a thread has it.
    device_learning: Option<Box<DeviceLearning>>,
    /// Boot and number of the window that a thread has.
    in_progress: Option<(u32, u32)>,
    /// Skew in seconds before a thread took the learning.
    skew_s: Option<f64>,
    events: Vec<LearningEvent>,
    /// Waiting windows, each with its place in the order of all.
    jobs: VecDeque<(u64, LearnJob)>,
    unlearned: u64,
    /// Number of events so far that [forget](LearningEvent::forgets).
    forgotten: u64,
}

fn skew_s(device_learning: &DeviceLearning) -> Option<f64> {
    device_learning
        .learning
        .correction()
        .map(|correction| correction.skew_s)
}

/// Queue of the windows of all devices.
#[derive(Default)]
pub struct Queue {
    devices: HashMap<String, Slot>,
    /// Devices with a window that can be learned now; the one whose turn is longest ago is the first.
    turns: VecDeque<String>,
    waiting: usize,
    arrivals: u64,
    /// Library of other hobs' pots.
    library: Option<Arc<Library>>,
}

impl Queue {
    /// Returns the number of windows that wait.
    pub fn waiting(&self) -> usize {
        self.waiting
    }

    /// Adds a device, or replaces its learning; its waiting windows stay.
    pub fn insert(&mut self, device: &str, learning: Learning) {
        let mut device_learning = DeviceLearning::new(learning);
        if let Some(library) = &self.library {
            device_learning.learning.use_library(Arc::clone(library));
        }
        let slot = self.slot(device);
        slot.events.clear();
        slot.device_learning = Some(Box::new(device_learning));
    }

    /// Returns `true` if the device is known.
    pub fn has_device(&self, device: &str) -> bool {
        self.devices.contains_key(device)
    }

    /// Counts a window that came too late to be learned.
    pub fn count_late(&mut self, device: &str) {
        if let Some(slot) = self.devices.get_mut(device) {
            slot.unlearned += 1;
        }
    }

    /// Returns the number of a device's windows that were dropped or came too late.
    pub fn unlearned_count(&self, device: &str) -> u64 {
        self.devices.get(device).map_or(0, |slot| slot.unlearned)
    }

    /// Returns how often a device's learning was to be forgotten.
    pub fn forgotten_count(&self, device: &str) -> u64 {
        self.devices.get(device).map_or(0, |slot| slot.forgotten)
    }

    /// Applies an event to a device's learning, now or after its current window.
    pub fn post(&mut self, device: &str, event: LearningEvent) {
        if let Some(slot) = self.devices.get_mut(device) {
            slot.forgotten += u64::from(event.forgets());
            match &mut slot.device_learning {
                Some(device_learning) => event.apply(&mut device_learning.learning),
                None => slot.events.push(event),
            }
        }
    }

    /// Returns a device's learning; `None` if the device is unknown or a thread has it.
    pub fn learning(&self, device: &str) -> Option<&Learning> {
        Some(&self.devices.get(device)?.device_learning.as_ref()?.learning)
    }

    /// Returns the skew in seconds to remove from the current of a device's windows; `None` if there is none.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        let slot = self.devices.get(device)?;
        slot.device_learning.as_deref().map_or(slot.skew_s, skew_s)
    }

    fn slot(&mut self, device: &str) -> &mut Slot {
        self.devices
            .entry(device.to_owned())
            .or_insert_with(|| Slot {
                device_learning: None,
                in_progress: None,
                skew_s: None,
                events: Vec::new(),
                jobs: VecDeque::new(),
                unlearned: 0,
                forgotten: 0,
            })
    }

    /// Adds a window of a known device. Beyond `limit` windows in all, the oldest of the device that has most
    /// of them waiting is dropped, so that a device that sends much costs the others nothing. With equal devices
    /// that is the oldest of all.
    pub fn push(&mut self, job: LearnJob, limit: usize) -> Option<DroppedWindow> {
        let device = job.device.clone();
        let arrivals = self.arrivals;
        let slot = self.devices.get_mut(&device)?;
        self.arrivals += 1;
        let was_idle = slot.device_learning.is_some() && slot.jobs.is_empty();
        slot.jobs.push_back((arrivals, job));
        self.waiting += 1;
        if was_idle {
            self.turns.push_back(device);
        }
        if self.waiting <= limit {
            return None;
        }
        self.drop_one()
    }

    fn drop_one(&mut self) -> Option<DroppedWindow> {
        let most = self.devices.iter_mut().max_by_key(|(_, slot)| {
            let oldest = slot
                .jobs
                .front()
                .map_or(u64::MAX, |(arrivals, _)| *arrivals);
            (slot.jobs.len(), std::cmp::Reverse(oldest))
        });
        let (name, slot) = most?;
        let (_, job) = slot.jobs.pop_front()?;
        slot.unlearned += 1;
        self.waiting -= 1;
        if slot.jobs.is_empty() {
            let name = name.clone();
            self.turns.retain(|turn| *turn != name);
        }
        Some(DroppedWindow {
            device: job.device,
            boot: job.boot,
            seq: job.input.window().seq,
        })
    }

    /// Takes the next window with its device's learning; the device's other windows wait until [`Queue::return_learning`].
    pub fn next(&mut self) -> Option<(LearnJob, Box<DeviceLearning>)> {
        let device = self.turns.pop_front()?;
        let slot = self.devices.get_mut(&device)?;
        let device_learning = slot.device_learning.take()?;
        slot.skew_s = skew_s(&device_learning);
        let Some((_, job)) = slot.jobs.pop_front() else {
            slot.device_learning = Some(device_learning);
            return None;
        };
        slot.in_progress = Some((job.boot, job.input.window().seq));
        self.waiting -= 1;
        Some((job, device_learning))
    }

    /// Takes the events of a device since [`Queue::next`].
    pub fn take_events(&mut self, device: &str) -> Vec<LearningEvent> {
        let slot = self.devices.get_mut(device);
        slot.map(|slot| std::mem::take(&mut slot.events))
            .unwrap_or_default()
    }

    /// Returns a device's learning from a thread, so that its next window can be learned from.
    pub fn return_learning(&mut self, device: &str, mut device_learning: Box<DeviceLearning>) {
        for event in self.take_events(device) {
            event.apply(&mut device_learning.learning);
        }
        if let Some(library) = &self.library {
            device_learning.learning.use_library(Arc::clone(library));
        }
        if let Some(slot) = self.devices.get_mut(device) {
            slot.in_progress = None;
            // One that was inserted meanwhile takes precedence.
            slot.device_learning.get_or_insert(device_learning);
            if !slot.jobs.is_empty() && !self.turns.iter().any(|turn| turn == device) {
                self.turns.push_back(device.to_owned());
            }
        }
    }

    /// Sets the library of other hobs' pots; returns `false` if it has not changed. A device at a thread gets it after its window.
    pub fn use_library(&mut self, library: Arc<Library>) -> bool {
        if self.library.as_ref() == Some(&library) {
            return false;
        }
        for slot in self.devices.values_mut() {
            if let Some(device_learning) = &mut slot.device_learning {
                device_learning.learning.use_library(Arc::clone(&library));
            }
        }
        self.library = Some(library);
        true
    }

    /// Returns `true` if this window waits, or a thread has it.
    pub fn is_pending(&self, device: &str, boot: u32, seq: u32) -> bool {
        let slot = self.devices.get(device);
        slot.is_some_and(|slot| {
            let mut jobs = slot.jobs.iter();
            slot.in_progress == Some((boot, seq))
                || jobs.any(|(_, job)| job.boot == boot && job.input.window().seq == seq)
        })
    }

    /// Drops all waiting windows; returns their number.
    pub fn clear(&mut self) -> usize {
        for slot in self.devices.values_mut() {
            slot.unlearned += slot.jobs.len() as u64;
            slot.jobs.clear();
        }
        self.turns.clear();
        std::mem::take(&mut self.waiting)
    }
}
