//! The host of a scenario: says hello, asks for power, keeps the link alive, and repeats itself if told so.

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    ClearFault, Configure, GetStatus, Message, PushLookup, Raw, ResetLookup, SetPower,
};
use ihd_shared::wire::number::Number;

use super::timeline::Repeated;
use crate::hob::SimHob;

/// How often an idle host asks for the status, in seconds.
const KEEP_ALIVE_S: f64 = 1.0;

struct Repeat {
    what: Repeated,
    every_s: f64,
    until_s: f64,
    next_s: f64,
    /// Whether a power that alternates is 0 next.
    zero_next: bool,
}

/// The host.
pub(super) struct Host {
    seq: u16,
    number: Number,
    silent: bool,
    keep_alive_s: f64,
    repeats: Vec<Repeat>,
    asked_w: u16,
}

impl Host {
    /// Says hello.
    pub(super) fn new(hob: &mut SimHob) -> Self {
        let mut host = Self {
            seq: 0,
            number: Number::NONE,
            silent: false,
            keep_alive_s: KEEP_ALIVE_S,
            repeats: Vec::new(),
            asked_w: 0,
        };
        host.send(hob, &ours(ROLE_HOST, 0, 0, "ihd scenario", "host"));
        host
    }

    /// Power asked for last, in watt.
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

    /// Nothing more, until told otherwise.
    pub(super) fn fall_silent(&mut self) {
        self.silent = true;
        self.repeats.clear();
    }

    pub(super) fn repeat(&mut self, what: Repeated, every_s: f64, until_s: f64, now_s: f64) {
        self.silent = false;
        self.repeats.push(Repeat {
            what,
            every_s,
            until_s,
            next_s: now_s,
            zero_next: false,
        });
    }

    /// After each block: what is due, and nothing heard is kept.
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
        let mut due = Vec::new();
        self.repeats.retain(|r| now_s < r.until_s);
        for r in self.repeats.iter_mut().filter(|r| now_s >= r.next_s) {
            r.next_s += r.every_s;
            due.push(match r.what {
                Repeated::Power(_, true) if r.zero_next => Repeated::Power(0, true),
                what => what,
            });
            r.zero_next = !r.zero_next;
        }
        for what in due {
            match what {
                Repeated::Power(power_w, _) => self.set_power(hob, power_w),
                Repeated::ClearFault => self.clear_fault(hob),
            }
        }
    }
}
