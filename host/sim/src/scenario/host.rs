//! Host of a scenario: sends hello, requests power, keeps the link alive, and repeats requests if configured.

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    ClearFault, Configure, GetStatus, Message, PushLookup, Raw, ResetLookup, SetPower,
};
use ihd_shared::wire::number::Number;

use super::timeline::RepeatedRequest;
use crate::hob::SimHob;

/// Period at which an idle host requests the status, in seconds.
const KEEP_ALIVE_S: f64 = 1.0;

/// Requests that a host repeats.
#[derive(Default)]
pub struct RepeatedRequests(Vec<Repeat>);

struct Repeat {
    what: RepeatedRequest,
    every_s: f64,
    until_s: f64,
    next_s: f64,
    /// `true` if an alternating power is 0 next.
    zero_next: bool,
}

impl RepeatedRequests {
    /// Adds one with its period and end, in seconds, from `now_s` on.
    pub fn add(&mut self, what: RepeatedRequest, every_s: f64, until_s: f64, now_s: f64) {
        self.0.push(Repeat {
            what,
            every_s,
            until_s,
            next_s: now_s,
            zero_next: false,
        });
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the requests that are due at `now_s`, each once.
    pub fn due(&mut self, now_s: f64) -> Vec<RepeatedRequest> {
        let mut due = Vec::new();
        self.0.retain(|r| now_s < r.until_s);
        for r in self.0.iter_mut().filter(|r| now_s >= r.next_s) {
            r.next_s += r.every_s;
            due.push(match r.what {
                RepeatedRequest::Power(_, true) if r.zero_next => RepeatedRequest::Power(0, true),
                what => what,
            });
            r.zero_next = !r.zero_next;
        }
        due
    }
}

/// The host.
pub(super) struct Host {
    seq: u16,
    number: Number,
    silent: bool,
    keep_alive_s: f64,
    repeats: RepeatedRequests,
    asked_w: u16,
}

impl Host {
    /// Creates the host and sends its hello.
    pub(super) fn new(hob: &mut SimHob) -> Self {
        let mut host = Self {
            seq: 0,
            number: Number::NONE,
            silent: false,
            keep_alive_s: KEEP_ALIVE_S,
            repeats: RepeatedRequests::default(),
            asked_w: 0,
        };
        host.send(hob, &ours(ROLE_HOST, 0, 0, "ihd scenario", "host"));
        host
    }

    /// Power requested last, in watt.
    pub(super) fn asked_w(&self) -> u16 {
        self.asked_w
    }

    fn send<M: Message>(&mut self, hob: &mut SimHob, message: &M) {
        self.silent = false;
        self.number = self.number.next();
        let mut frame = [0; MAX_ENCODED];
        let n = encode_numbered(message, self.number, self.seq, &mut frame)
            .expect("a host's messages fit a frame");
        self.seq = self.seq.wrapping_add(1);
        hob.send(&frame[..n]);
    }

    pub(super) fn set_power(&mut self, hob: &mut SimHob, power_w: u16) {
        self.asked_w = power_w;
        self.send(hob, &SetPower { power_w });
    }

    pub(super) fn clear_fault(&mut self, hob: &mut SimHob) {
        self.send(hob, &ClearFault {});
    }

    pub(super) fn push_lookup(&mut self, hob: &mut SimHob, lookup: &RlLookup) {
        let bytes = lookup.to_bytes();
        self.send(hob, &PushLookup { blob: Raw(&bytes) });
    }

    pub(super) fn reset_lookup(&mut self, hob: &mut SimHob) {
        self.send(hob, &ResetLookup {});
    }

    pub(super) fn configure(&mut self, hob: &mut SimHob, settings: &Configure) {
        self.send(hob, settings);
    }

    /// Stops sending until the next request.
    pub(super) fn fall_silent(&mut self) {
        self.silent = true;
        self.repeats.clear();
    }

    pub(super) fn repeat(&mut self, what: RepeatedRequest, every_s: f64, until_s: f64, now_s: f64) {
        self.silent = false;
        self.repeats.add(what, every_s, until_s, now_s);
    }

    /// Runs after each block: sends due requests and discards received bytes.
    pub(super) fn turn(&mut self, hob: &mut SimHob) {
        let mut heard = [0; 1024];
        while hob.receive(&mut heard) > 0 {}
        let now_s = hob.t_s();
        if self.silent {
            return;
        }
        if now_s >= self.keep_alive_s {
            self.keep_alive_s = now_s + KEEP_ALIVE_S;
            self.send(hob, &GetStatus {});
        }
        for what in self.repeats.due(now_s) {
            match what {
                RepeatedRequest::Power(power_w, _) => self.set_power(hob, power_w),
                RepeatedRequest::ClearFault => self.clear_fault(hob),
            }
        }
    }
}
