//! Promises of the daemon, checked while it lives.

use std::collections::BTreeSet;
use std::time::Duration;

use ihd_shared::wire::messages::AnyMessage;
use tokio::time::Instant;

use super::hob::read;
use super::world::{HOBS, World};
use crate::model::{Notice, What};
use crate::store_queue::{DAEMON, DEVICE, RESERVE};

/// A hob that nobody holds heats for so long at most: the host's time-out of its firmware, and a second.
const UNHELD_AT_MOST: Duration = Duration::from_secs(11);

/// The same where nothing fails: a lease that ran out is seen at the next tick.
const UNHELD_WHERE_CALM: Duration = Duration::from_millis(500);

/// The daemon tells of power that a hob has not for so long at most: what it compares after, two links that do not answer, and the longest wait
/// between two tries to connect.
const WRONG_AT_MOST: Duration = Duration::from_secs(20);

/// The same where nothing but a stranger's hello happens: KEEPALIVE_PERIOD, and a tick.
const WRONG_WHERE_CALM: Duration = Duration::from_millis(2_500);

/// Orders that may wait for the store.
const STORE_WAITING: usize = DAEMON + RESERVE + HOBS.len() * (DEVICE + RESERVE);

/// Record of what the promises are checked against.
#[derive(Default)]
pub struct Promises {
    /// The first promise that was broken.
    pub broken: Option<String>,
    /// Windows of which the daemon said that they are stored: hob, boot, number.
    pub stored: BTreeSet<(usize, u32, u32)>,
    /// The same of results.
    pub results: BTreeSet<(usize, u32, u32)>,
    /// Numbers requests of users in the order in which they were made.
    requests: u64,
    places: [Place; HOBS.len()],
}

/// The same of one hob.
#[derive(Default)]
struct Place {
    /// The last request that may heat.
    last_heating: u64,
    /// The last `off` that was acknowledged, by its number.
    off: Option<u64>,
    /// Since when it heats, or would, without a living lease.
    unheld_since: Option<Duration>,
    /// Since when the daemon tells of a power that it has not.
    wrong_since: Option<Duration>,
}

impl Place {
    /// Says what is wrong where the daemon has told for too long of power, `told_w`, that the hob has not.
    fn is_wrong(
        &mut self,
        told_w: u16,
        asked_w: u16,
        now: Duration,
        is_calm: bool,
    ) -> Option<String> {
        if told_w == 0 || told_w == asked_w {
            self.wrong_since = None;
            return None;
        }
        let since = *self.wrong_since.get_or_insert(now);
        let bound = match is_calm {
            true => WRONG_WHERE_CALM,
            false => WRONG_AT_MOST,
        };
        (now - since > bound).then(|| {
            let since_s = since.as_secs_f64();
            format!("a lease tells of {told_w} W since {since_s:.3} s, and the hob has {asked_w} W")
        })
    }
}

impl Promises {
    fn note_broken(&mut self, why: String) {
        self.broken.get_or_insert(why);
    }

    fn next_request(&mut self) -> u64 {
        self.requests += 1;
        self.requests
    }
}

impl World {
    /// Counts a user's request that may heat.
    pub fn number_heating_request(&self, hob: usize) {
        let promises = &mut self.lock().promises;
        promises.places[hob].last_heating = promises.next_request();
    }

    /// Counts a user's `off`; returns its number.
    pub fn number_off_request(&self) -> u64 {
        self.lock().promises.next_request()
    }

    /// Records an `off` that was acknowledged: the hob is off, and stays so until somebody asks again.
    pub fn off_acknowledged(&self, hob: usize, number: u64) {
        let state = &mut *self.lock();
        let (place, asked_w) = (
            &mut state.promises.places[hob],
            state.sockets[hob].hob.asked_w(),
        );
        place.off = place.off.max(Some(number));
        if asked_w > 0 && place.last_heating < number {
            let name = HOBS[hob];
            state
                .promises
                .note_broken(format!("off was acknowledged and {name} has {asked_w} W"));
        }
    }

    /// Delivers a frame to a hob: the daemon's, or a stranger's hello.
    pub fn deliver(&self, hob: usize, frame: &[u8]) {
        let asked = |message: &AnyMessage<'_>| match message {
            AnyMessage::SetPower(m) => Some(m.power_w),
            _ => None,
        };
        let is_hello = |message: &AnyMessage<'_>| matches!(message, AnyMessage::Hello(_));
        let of_frame = read(frame, |_, message| (asked(message), is_hello(message)));
        let (power_w, is_hello) = of_frame.unwrap_or_default();
        if let Some(power_w) = power_w {
            self.note(&format!("{} is asked for {power_w} W", HOBS[hob]));
            if power_w > 0 {
                self.check_power(hob, power_w);
            }
        }
        let state = &mut *self.lock();
        let place = &mut state.sockets[hob].hob;
        place.receive(frame);
        let asked_w = place.asked_w();
        if is_hello && asked_w > 0 {
            state.promises.note_broken(format!(
                "a conversation with {} begins with {asked_w} W of the one before it",
                HOBS[hob]
            ));
        }
    }

    fn check_power(&self, hob: usize, power_w: u16) {
        let is_held = self.daemon().is_some_and(|daemon| {
            let handle = daemon.handle_of(HOBS[hob]);
            handle.is_some_and(|handle| {
                let lease = &handle.face.lock().lease;
                lease.heats(Instant::now()) && lease.asked_w() == power_w
            })
        });
        let promises = &mut self.lock().promises;
        let place = &promises.places[hob];
        let name = HOBS[hob];
        if place.off.is_some_and(|off| off > place.last_heating) {
            promises.note_broken(format!(
                "{name} is asked for {power_w} W after an off that was acknowledged"
            ));
        } else if !is_held {
            promises.note_broken(format!(
                "{name} is asked for {power_w} W that no living lease answers for"
            ));
        }
    }

    /// Checks what has to hold at any time.
    pub fn check_now(&self) {
        let now = self.now();
        let daemon = self.daemon();
        if let Some(daemon) = &daemon {
            let waiting = daemon.figures().store_waiting;
            if waiting > STORE_WAITING {
                let why = format!("{waiting} jobs wait for the store");
                self.lock().promises.note_broken(why);
            }
        }
        for (hob, name) in HOBS.iter().enumerate() {
            let handle = daemon.as_ref().and_then(|daemon| daemon.handle_of(name));
            let told_w = handle.map_or(0, |handle| {
                let lease = &handle.face.lock().lease;
                match lease.heats(Instant::now()) {
                    true => lease.asked_w(),
                    false => 0,
                }
            });
            let is_held = told_w > 0;
            let state = &mut *self.lock();
            let socket = &mut state.sockets[hob];
            socket.hob.live_until(now);
            let asked_w = socket.hob.asked_w();
            let place = &mut state.promises.places[hob];
            if let Some(wrong) = place.is_wrong(told_w, asked_w, now, self.is_calm) {
                state.promises.note_broken(format!("{name}: {wrong}"));
            }
            let place = &mut state.promises.places[hob];
            if socket.hob.asked_w() == 0 || is_held {
                place.unheld_since = None;
                continue;
            }
            let since = *place.unheld_since.get_or_insert(now);
            let bound = match self.is_calm {
                true => UNHELD_WHERE_CALM,
                false => UNHELD_AT_MOST,
            };
            if now - since > bound {
                let asked_w = socket.hob.asked_w();
                state.promises.note_broken(format!(
                    "{name} heats with {asked_w} W since {:.3} s, and no lease lives",
                    since.as_secs_f64()
                ));
            }
        }
    }

    /// Records a notice of the daemon.
    pub fn record_notice(&self, notice: &Notice) {
        let Some(hob) = HOBS.iter().position(|name| *name == notice.device) else {
            return;
        };
        let promises = &mut self.lock().promises;
        match notice.what {
            What::WindowStored { boot, seq } => {
                promises.stored.insert((hob, boot, seq));
            }
            What::ResultStored { boot, seq, .. } => {
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
