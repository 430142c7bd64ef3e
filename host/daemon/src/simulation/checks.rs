//! Promises of the daemon, checked while it runs.

use std::time::Duration;

use ihd_model::{DaemonEvent, EventKind};
use ihd_shared::wire::messages::AnyMessage;
use tokio::time::Instant;

use super::hob::{HOBS, read_frame};
use super::world::World;
use crate::store_queue::{DAEMON, DEVICE, RESERVE};

/// Longest heating without a lease: the host time-out of the firmware, and a second.
const UNHELD_LIMIT: Duration = Duration::from_secs(11);

/// Longest heating without a lease if no faults occur: an expired lease is noticed at the next tick.
const UNHELD_LIMIT_CALM: Duration = Duration::from_millis(500);

/// Largest number of jobs that may wait for the store.
const STORE_WAITING: usize = DAEMON + RESERVE + HOBS.len() * (DEVICE + RESERVE);

impl World {
    /// Numbers a user's request that may heat.
    pub fn number_heating_request(&self, hob: usize) {
        let promises = &mut self.lock().promises;
        promises.hobs[hob].last_heating = promises.next_request();
    }

    /// Numbers a user's `off`; returns the number.
    pub fn number_off_request(&self) -> u64 {
        self.lock().promises.next_request()
    }

    /// Records an acknowledged `off`: the hob is off, and stays off until the next request.
    pub fn off_acknowledged(&self, hob: usize, number: u64) {
        let state = &mut *self.lock();
        let (record, asked_w) = (
            &mut state.promises.hobs[hob],
            state.sockets[hob].hob.asked_w(),
        );
        record.off = record.off.max(Some(number));
        if asked_w > 0 && record.last_heating < number {
            let name = HOBS[hob];
            state
                .promises
                .note_broken(format!("off was acknowledged and {name} has {asked_w} W"));
        }
    }

    /// Delivers a frame to a hob: one of the daemon, or a foreign hello.
    pub fn deliver(&self, hob: usize, frame: &[u8]) {
        let asked = |message: &AnyMessage<'_>| match message {
            AnyMessage::SetPower(m) => Some(m.power_w),
            _ => None,
        };
        let is_hello = |message: &AnyMessage<'_>| matches!(message, AnyMessage::Hello(_));
        let of_frame = read_frame(frame, |_, message| (asked(message), is_hello(message)));
        let (power_w, is_hello) = of_frame.unwrap_or_default();
        if let Some(power_w) = power_w {
            self.note(&format!("{} is asked for {power_w} W", HOBS[hob]));
            if power_w > 0 {
                self.check_power(hob, power_w);
            }
        }
        let state = &mut *self.lock();
        let receiver = &mut state.sockets[hob].hob;
        receiver.receive(frame);
        let asked_w = receiver.asked_w();
        if is_hello && asked_w > 0 {
            state.promises.note_broken(format!(
                "a conversation with {} begins with {asked_w} W of the previous one",
                HOBS[hob]
            ));
        }
    }

    fn check_power(&self, hob: usize, power_w: u16) {
        let is_held = self.daemon().is_some_and(|daemon| {
            let handle = daemon.handle_of(HOBS[hob]);
            handle.is_some_and(|handle| {
                let lease = &handle.record.lock().lease;
                lease.heats(Instant::now()) && lease.asked_w() == power_w
            })
        });
        let promises = &mut self.lock().promises;
        let record = &promises.hobs[hob];
        let name = HOBS[hob];
        if record.off.is_some_and(|off| off > record.last_heating) {
            promises.note_broken(format!(
                "{name} is asked for {power_w} W after an off that was acknowledged"
            ));
        } else if !is_held {
            promises.note_broken(format!(
                "{name} is asked for {power_w} W without a valid lease"
            ));
        }
    }

    /// Checks the promises that hold at any time.
    pub fn check_now(&self) {
        let now = self.now();
        let daemon = self.daemon();
        if let Some(daemon) = &daemon {
            let waiting = daemon.upkeep().figures().store_waiting;
            if waiting > STORE_WAITING {
                let why = format!("{waiting} jobs wait for the store");
                self.lock().promises.note_broken(why);
            }
        }
        for (hob, name) in HOBS.iter().enumerate() {
            let handle = daemon.as_ref().and_then(|daemon| daemon.handle_of(name));
            let reported_w = handle.map_or(0, |handle| {
                let lease = &handle.record.lock().lease;
                match lease.heats(Instant::now()) {
                    true => lease.asked_w(),
                    false => 0,
                }
            });
            let is_held = reported_w > 0;
            let state = &mut *self.lock();
            let socket = &mut state.sockets[hob];
            socket.hob.advance_to(now);
            let asked_w = socket.hob.asked_w();
            let record = &mut state.promises.hobs[hob];
            if let Some(wrong) = record.check_report(reported_w, asked_w, now, self.is_calm) {
                state.promises.note_broken(format!("{name}: {wrong}"));
            }
            let record = &mut state.promises.hobs[hob];
            if socket.hob.asked_w() == 0 || is_held {
                record.unheld_since = None;
                continue;
            }
            let since = *record.unheld_since.get_or_insert(now);
            let bound = match self.is_calm {
                true => UNHELD_LIMIT_CALM,
                false => UNHELD_LIMIT,
            };
            if now - since > bound {
                let asked_w = socket.hob.asked_w();
                state.promises.note_broken(format!(
                    "{name} heats with {asked_w} W since {:.3} s without a valid lease",
                    since.as_secs_f64()
                ));
            }
        }
    }

    /// Records an event of the daemon.
    pub fn record_event(&self, event: &DaemonEvent) {
        let Some(hob) = HOBS.iter().position(|name| *name == event.device) else {
            return;
        };
        let promises = &mut self.lock().promises;
        match event.kind {
            EventKind::WindowStored { boot, seq } => {
                promises.stored.insert((hob, boot, seq));
            }
            EventKind::ResultStored { boot, seq, .. } => {
                promises.results.insert((hob, boot, seq));
            }
            _ => {}
        }
    }

    /// Records that a promise was broken.
    pub fn note_broken(&self, why: String) {
        self.lock().promises.note_broken(why);
    }
}
