//! A simulated hob, and what can be done to its link.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_doctor::{Check, CheckResult};
use ihd_link::{Client, LinkError, Transport};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::AnyMessage;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

/// A hob on a bench: DC on its bus, 24 V~ at its detector.
pub fn on_bench(bench_supply_v: f64) -> HobConfig {
    HobConfig {
        bench_supply_v: Some(bench_supply_v),
        ..HobConfig::default()
    }
}

pub fn connected(config: &HobConfig) -> (Client, SharedHob) {
    let hob = SharedHob::new(SimHob::new(config));
    (Client::connect(Box::new(hob.clone())).unwrap(), hob)
}

/// Finds the check of a name; there must be one.
pub fn find_check<'a>(checks: &'a [Check], name: &str) -> &'a Check {
    let mut found = checks.iter().filter(|check| check.name == name);
    let check = found
        .next()
        .unwrap_or_else(|| panic!("no {name}: {checks:#?}"));
    assert!(found.next().is_none(), "{name} twice");
    check
}

/// Asserts that each check is there, once, with any result.
pub fn complete(checks: &[Check], names: &[&str]) {
    for name in names {
        find_check(checks, name);
    }
    assert_eq!(checks.len(), names.len(), "{checks:#?}");
}

/// The names of those that failed.
pub fn failed(checks: &[Check]) -> Vec<&str> {
    let failed = checks.iter().filter(|c| c.verdict == CheckResult::Fail);
    failed.map(|c| c.name).collect()
}

/// A link that is seen, cut, or thinned.
pub struct Watched {
    inner: SharedHob,
    deframer: Deframer,
    /// Frames that a host may still send before the cable is pulled.
    pub frames_left: Arc<AtomicU32>,
    /// Every so many receptions a byte is turned; 0 for none.
    pub turn_every: u64,
    received: AtomicU64,
    /// Powers that were asked for.
    pub asked_w: Arc<Mutex<Vec<u16>>>,
}

impl Watched {
    pub fn new(inner: SharedHob) -> Self {
        Self {
            inner,
            deframer: Deframer::new(),
            frames_left: Arc::new(AtomicU32::new(u32::MAX)),
            turn_every: 0,
            received: AtomicU64::new(0),
            asked_w: Arc::default(),
        }
    }

    fn gone(&self) -> LinkError {
        LinkError::Closed {
            device: self.describe(),
        }
    }
}

impl Transport for Watched {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            if let Some(Ok(frame)) = self.deframer.push(byte)
                && let Ok(AnyMessage::SetPower(set)) = AnyMessage::decode(frame.id, frame.split().1)
            {
                self.asked_w.lock().unwrap().push(set.power_w);
            }
        }
        let left = self.frames_left.load(Ordering::Relaxed);
        if left == 0 {
            return Err(self.gone());
        }
        self.frames_left.store(left - 1, Ordering::Relaxed);
        self.inner.send(bytes)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        if self.frames_left.load(Ordering::Relaxed) == 0 {
            return Err(self.gone());
        }
        let n = self.inner.receive(buf, timeout)?;
        let count = self.received.fetch_add(1, Ordering::Relaxed) + 1;
        if n > 0 && self.turn_every > 0 && count.is_multiple_of(self.turn_every) {
            buf[n / 2] ^= 0x55;
        }
        Ok(n)
    }

    fn describe(&self) -> String {
        "watched".to_owned()
    }

    fn clock(&self) -> Duration {
        self.inner.clock()
    }
}
