//! Host controller at the other end of the cable, in emulated time.
//!
//! Frames of a millisecond, each with as many transactions as full speed allows (19 of 64 bytes); NAK repeats a transaction,
//! STALL ends a transfer. Other threads submit transfers through a [`super::Cable`].

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use super::bus::{Device, Toggle};
use super::cable::{Command, Shared};
use super::transfer::{Pipe, Progress, Request, Status, Transfer};

#[cfg(test)]
mod tests;

const FRAME_US: f64 = 1_000.0;
/// Duration of a start of frame on the bus.
const START_US: f64 = 4.0;
/// Duration of the longest transaction: none begins that would reach into the next frame.
const MAX_TRANSACTION_US: f64 = 52.0;
/// Polling period of the idle controller.
const IDLE_US: f64 = 10.0;
/// Duration of a reset of the bus, and of a device's recovery after it (USB 2.0, 7.1.7.5).
const RESET_US: f64 = 10_000.0;
const RECOVERY_US: f64 = 10_000.0;
/// Time that a device has after SET_ADDRESS (USB 2.0, 9.2.6.3).
const ADDRESS_US: f64 = 2_000.0;
/// Real time that emulated time waits for a slow reader.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest time that is made up for after a pause.
const BEHIND_US: f64 = 5_000.0;

/// Host controller, polled by the machine's thread.
pub struct HostController {
    commands: Receiver<Command>,
    shared: Arc<Shared>,
    queues: BTreeMap<Pipe, VecDeque<Transfer>>,
    toggles: BTreeMap<Pipe, Toggle>,
    /// Pipe that was served last.
    last: Pipe,
    plugged: bool,
    /// Set if the bus was reset since the device was attached: only then are there packets on it.
    enabled: bool,
    address: u8,
    frame: u16,
    /// Time from which the bus is free; `None` before the first poll.
    free_us: Option<f64>,
    next_frame_us: f64,
    /// End of the reset of the bus.
    reset_until_us: f64,
    /// Pipes that pause until a time, for example since the device did not respond.
    resting: BTreeMap<Pipe, f64>,
    /// Pipe that is read continuously.
    read: Option<Pipe>,
}

impl Drop for HostController {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
    }
}

impl HostController {
    pub(super) fn new(commands: Receiver<Command>, shared: Arc<Shared>) -> Self {
        Self {
            commands,
            shared,
            queues: BTreeMap::new(),
            toggles: BTreeMap::new(),
            last: (0, false),
            plugged: false,
            enabled: false,
            address: 0,
            frame: 0,
            free_us: None,
            next_frame_us: 0.0,
            reset_until_us: 0.0,
            resting: BTreeMap::new(),
            read: None,
        }
    }

    /// Processes the bus until `now_us`; to be called about every ten microseconds.
    pub fn poll(&mut self, device: &mut dyn Device, now_us: f64) {
        let free = *self.free_us.get_or_insert(now_us);
        if now_us < free {
            return;
        }
        self.shared
            .now_ns
            .store((now_us * 1e3) as u64, Ordering::Relaxed);
        while let Ok(command) = self.commands.try_recv() {
            self.obey(command);
        }
        self.wait_for_reader();
        let mut time = free.max(now_us - BEHIND_US);
        self.next_frame_us = self.next_frame_us.max(time - FRAME_US);
        while time <= now_us {
            self.watch(device);
            time += self.advance(device, time);
        }
        self.free_us = Some(time);
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Plug(plugged) => {
                self.plugged = plugged;
                // At once: the cable may be plugged in again before the next poll.
                if !plugged {
                    self.lost();
                }
            }
            Command::Submit(id, request, done) if request != Request::Reset && !self.enabled => {
                Transfer::new(id, request, done).finish(Status::Gone);
            }
            Command::Submit(id, request, done) => {
                let queue = self.queues.entry(request.pipe()).or_default();
                if matches!(request, Request::In { .. }) {
                    self.read = Some(request.pipe());
                }
                queue.push_back(Transfer::new(id, request, done));
            }
            Command::Cancel(id) => {
                self.read = None;
                for queue in self.queues.values_mut() {
                    let place = queue.iter().position(|transfer| transfer.id == id);
                    if let Some(transfer) = place.and_then(|place| queue.remove(place)) {
                        transfer.finish(Status::Cancelled);
                    }
                }
            }
        }
    }

    fn wait_for_reader(&mut self) {
        let patient = self.shared.patient.load(Ordering::Relaxed);
        while let Some(pipe) = self.read.filter(|_| patient) {
            if self
                .queues
                .get(&pipe)
                .is_some_and(|queue| !queue.is_empty())
            {
                return;
            }
            match self.commands.recv_timeout(PATIENCE) {
                Ok(command) => self.obey(command),
                // The reader has stopped.
                Err(_) => self.read = None,
            }
        }
    }

    /// Detects that the device is attached or detached.
    fn watch(&mut self, device: &dyn Device) {
        let attached = self.plugged && device.attached();
        let before = self.shared.attached.swap(attached, Ordering::Relaxed);
        if before && !attached {
            self.lost();
        }
    }

    /// Ends all transfers, as no device is attached any more.
    fn lost(&mut self) {
        self.enabled = false;
        self.read = None;
        for transfer in self.queues.values_mut().flat_map(|queue| queue.drain(..)) {
            transfer.finish(Status::Gone);
        }
    }

    /// Advances the bus by one step; returns its duration in microseconds.
    fn advance(&mut self, device: &mut dyn Device, time: f64) -> f64 {
        let attached = self.shared.attached.load(Ordering::Relaxed);
        if time < self.reset_until_us && self.enabled {
            self.next_frame_us = self.reset_until_us;
            return IDLE_US;
        }
        if time >= self.next_frame_us {
            self.next_frame_us += FRAME_US;
            if !self.enabled {
                device.missing_frame();
                return START_US;
            }
            self.frame = (self.frame + 1) & 0x7FF;
            device.start_of_frame(self.frame);
            return START_US;
        }
        let left = self.next_frame_us - time;
        if !attached || left < MAX_TRANSACTION_US {
            return left.min(IDLE_US);
        }
        match self.next_pipe(time) {
            Some(pipe) => self.transaction(device, pipe, time),
            None => left.min(IDLE_US),
        }
    }

    /// Next pipe with a pending transfer, in turn.
    fn next_pipe(&mut self, time: f64) -> Option<Pipe> {
        self.resting.retain(|_, until| *until > time);
        let after = self.queues.range((Excluded(self.last), Unbounded));
        let mut in_turn = after.chain(self.queues.range(..=self.last));
        let ready =
            in_turn.find(|(pipe, queue)| !queue.is_empty() && !self.resting.contains_key(pipe));
        self.last = *ready?.0;
        Some(self.last)
    }

    fn transaction(&mut self, device: &mut dyn Device, pipe: Pipe, time: f64) -> f64 {
        let Some(transfer) = self.queues.get_mut(&pipe).and_then(VecDeque::front_mut) else {
            return IDLE_US;
        };
        let toggle = self.toggles.entry(pipe).or_default();
        let (takes, progress) = transfer.step(device, self.address, toggle);
        match progress {
            Progress::Silence => {
                self.resting.insert(pipe, self.next_frame_us);
                takes
            }
            Progress::Over(status) => {
                self.over(device, pipe, status, time);
                takes
            }
            Progress::More | Progress::Refused => takes,
        }
    }

    /// Ends the first transfer of a pipe and updates the controller's state.
    fn over(&mut self, device: &mut dyn Device, pipe: Pipe, status: Status, time: f64) {
        let Some(transfer) = self.queues.get_mut(&pipe).and_then(VecDeque::pop_front) else {
            return;
        };
        match transfer.request {
            Request::Reset => {
                device.bus_reset();
                self.enabled = true;
                self.address = 0;
                self.toggles.clear();
                self.reset_until_us = time + RESET_US;
                self.resting.insert(pipe, time + RESET_US + RECOVERY_US);
            }
            Request::Control { setup, .. } => {
                let waits = if status == Status::Done {
                    self.heard(setup)
                } else {
                    0.0
                };
                // Drivers are notified by an interrupt at the next frame, so the next control transfer is not earlier.
                self.resting
                    .insert(pipe, self.next_frame_us.max(time + waits));
            }
            _ => {}
        }
        transfer.finish(status);
    }

    /// Applies a completed control transfer to the controller's state; returns the time that the device then has, in microseconds.
    fn heard(&mut self, setup: [u8; 8]) -> f64 {
        match setup {
            // SET_ADDRESS.
            [0x00, 5, address, ..] => {
                self.address = address & 0x7F;
                return ADDRESS_US;
            }
            // SET_CONFIGURATION, SET_INTERFACE: all endpoints begin with DATA0.
            [0x00, 9, ..] | [0x01, 11, ..] => self.toggles.clear(),
            // CLEAR_FEATURE of an endpoint's halt.
            [0x02, 1, 0, 0, endpoint, ..] => {
                self.toggles.remove(&(endpoint & 0xF, endpoint & 0x80 != 0));
            }
            _ => {}
        }
        0.0
    }
}
