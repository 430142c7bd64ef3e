//! Buffer of telemetry, by seconds, between devices and store.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard};

use ihd_shared::wire::messages::Telemetry;
use ihd_store::{Spread, TelemetrySecond, TelemetrySpan};

use crate::live::ring::heats;
use crate::locking::lock;

/// Capacity in seconds waiting for the store: ten minutes of 32 devices, some 5 MB.
const MAX_WAITING: usize = 19_200;

/// Largest number of devices with a present second. More appear only if boards are plugged in with ever new serial numbers.
const MAX_DEVICES: usize = 256;

/// Telemetry of all devices that is not stored yet.
#[derive(Default)]
pub struct TelemetryBuffer {
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    /// Present second of each device.
    now: BTreeMap<String, TelemetrySpan>,
    waiting: VecDeque<TelemetrySecond>,
    /// Batch being written by the store.
    writing: Vec<TelemetrySecond>,
    dropped: u64,
}

impl Inner {
    fn enqueue(&mut self, device: String, span: TelemetrySpan) {
        if self.waiting.len() + self.writing.len() >= MAX_WAITING
            && self.waiting.pop_front().is_some()
        {
            self.dropped += 1;
        }
        self.waiting.push_back(TelemetrySecond { device, span });
    }

    /// Completes all present seconds other than `at_s`.
    fn complete_except(&mut self, at_s: i64) {
        let completed = self.now.extract_if(.., |_, span| span.at_s != at_s);
        for (device, span) in completed.collect::<Vec<_>>() {
            self.enqueue(device, span);
        }
    }
}

/// Returns a second that contains only this half-cycle.
fn span(t: &Telemetry, at_s: i64) -> TelemetrySpan {
    let heating = |x: i64| match heats(t) {
        true => Spread::from_value(x),
        false => Spread::default(),
    };
    TelemetrySpan {
        at_s,
        asked_w: t.asked_w,
        state: t.state as u8,
        pot: t.pot as u8,
        fault: t.fault.number(),
        power_mw: Spread::from_value(i64::from(t.power_mw)),
        i_crest_ma: Spread::from_value(i64::from(t.i_crest_ma)),
        r_uohm: heating(i64::from(t.r.0)),
        l_ph: heating(i64::from(t.l.0)),
        f_sw_hz: heating(i64::from(t.f_sw_hz)),
    }
}

impl TelemetryBuffer {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Poisoning is ignored: no lock scope leaves a half-written value.
        lock(&self.inner)
    }

    /// Adds a half-cycle of a device at this time in milliseconds since 1970, UTC.
    pub fn push(&self, device: &str, t: &Telemetry, at_ms: i64) {
        let half_cycle = span(t, at_ms.div_euclid(1_000));
        let mut inner = self.lock();
        match inner.now.get_mut(device) {
            Some(now) if now.at_s == half_cycle.at_s => now.merge(&half_cycle),
            Some(now) => {
                let completed = std::mem::replace(now, half_cycle);
                inner.enqueue(device.to_owned(), completed);
            }
            None => {
                if inner.now.len() >= MAX_DEVICES {
                    inner.complete_except(i64::MIN);
                }
                inner.now.insert(device.to_owned(), half_cycle);
            }
        }
    }

    /// Returns the batch to be written: all completed seconds, with `all` the present ones, too. Returns the same batch
    /// until [`TelemetryBuffer::confirm_batch`] or [`TelemetryBuffer::return_batch`] is called.
    pub fn take_batch(&self, at_ms: i64, all: bool) -> Vec<TelemetrySecond> {
        let mut inner = self.lock();
        let now_s = if all {
            i64::MIN
        } else {
            at_ms.div_euclid(1_000)
        };
        inner.complete_except(now_s);
        if inner.writing.is_empty() {
            inner.writing = std::mem::take(&mut inner.waiting).into();
        }
        inner.writing.clone()
    }

    /// Drops the batch, which is stored.
    pub fn confirm_batch(&self) {
        self.lock().writing.clear();
    }

    /// Returns the batch to the queue, because it was not stored.
    pub fn return_batch(&self) {
        let mut inner = self.lock();
        let mut waiting: VecDeque<_> = std::mem::take(&mut inner.writing).into();
        waiting.append(&mut inner.waiting);
        inner.waiting = waiting;
    }

    /// Returns the number of seconds dropped because the store was too slow.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// Returns the seconds of a device that are not confirmed as stored, oldest first.
    pub fn unwritten(&self, device: &str) -> Vec<TelemetrySpan> {
        let inner = self.lock();
        let past = inner.writing.iter().chain(&inner.waiting);
        let past = past.filter(|second| second.device == device);
        let now = inner.now.get(device);
        past.map(|second| &second.span)
            .chain(now)
            .cloned()
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;
    use ihd_shared::wire::messages::State;

    use super::*;

    #[test]
    fn half_cycles_become_seconds_that_wait_until_they_are_written() {
        let buffer = TelemetryBuffer::default();
        let mut t = telemetry(State::Heating);
        t.f_sw_hz = 45_000;
        for k in 0..250u32 {
            t.power_mw = 1_000_000 + k;
            buffer.push("a", &t, 10_000 + 10 * i64::from(k));
        }
        buffer.push("b", &telemetry(State::Idle), 12_000);
        let of_a = buffer.unwritten("a");
        assert_eq!(
            of_a.iter()
                .map(|s| (s.at_s, s.half_cycles()))
                .collect::<Vec<_>>(),
            [(10, 100), (11, 100), (12, 50)]
        );
        let power = of_a[1].power_mw.min_mean_max().unwrap();
        assert_eq!(power, [1_000_100.0, 1_000_149.5, 1_000_199.0]);
        assert_eq!(of_a[1].f_sw_hz.count(), 100);
        // The present second is not over.
        assert_eq!(buffer.take_batch(12_900, false).len(), 2);
        assert_eq!(
            buffer.unwritten("a"),
            of_a,
            "until it is written it is here"
        );
        buffer.return_batch();
        let taken = buffer.take_batch(13_000, false);
        assert_eq!(taken.len(), 4, "those of who fell silent, too");
        assert_eq!((taken[0].span.at_s, taken[3].device.as_str()), (10, "b"));
        buffer.push("a", &t, 13_000);
        buffer.confirm_batch();
        assert_eq!(buffer.unwritten("a").len(), 1);
        assert!(buffer.unwritten("b").is_empty());
        assert_eq!(buffer.take_batch(13_000, true).len(), 1, "at the end all");
    }

    #[test]
    fn what_the_store_does_not_take_is_bounded_and_counted() {
        let buffer = TelemetryBuffer::default();
        let t = telemetry(State::Idle);
        // A store that takes nothing, and a day.
        for at_s in 0..86_400 {
            buffer.push("a", &t, at_s * 1_000);
            if at_s % 500 == 0 {
                buffer.take_batch(at_s * 1_000, false);
                buffer.return_batch();
            }
        }
        let waits = buffer.unwritten("a");
        assert_eq!(waits.len(), MAX_WAITING + 1);
        assert_eq!(buffer.dropped(), 86_400 - MAX_WAITING as u64 - 1);
        assert_eq!(waits.last().unwrap().at_s, 86_399, "the oldest go first");
        for k in 0..1_000 {
            buffer.push(&format!("usb:{k}"), &t, 86_400_000);
        }
        assert!(buffer.lock().now.len() <= MAX_DEVICES);
        assert!(buffer.lock().waiting.len() <= MAX_WAITING);
    }
}
