//! Seconds of all devices that wait for the store.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use ihd_shared::wire::messages::Telemetry;
use ihd_store::{Spread, TelemetrySecond, TelemetrySpan};

use crate::live::heats;

/// Seconds that may wait for the store: ten minutes of 32 devices, some 5 MB.
const WAITING: usize = 19_200;

/// Devices whose present second is kept; more are those of a USB port that somebody plays with.
const DEVICES: usize = 256;

/// Seconds of all devices that are not in the store yet.
#[derive(Default)]
pub struct Seconds {
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    /// The present second of each device.
    now: BTreeMap<String, TelemetrySpan>,
    waiting: VecDeque<TelemetrySecond>,
    /// At the store.
    writing: Vec<TelemetrySecond>,
    dropped: u64,
}

impl Inner {
    fn wait(&mut self, device: String, span: TelemetrySpan) {
        if self.waiting.len() + self.writing.len() >= WAITING && self.waiting.pop_front().is_some()
        {
            self.dropped += 1;
        }
        self.waiting.push_back(TelemetrySecond { device, span });
    }

    /// Seconds that are over go and wait.
    fn close_before(&mut self, at_s: i64) {
        let over = self.now.extract_if(.., |_, span| span.at_s != at_s);
        for (device, span) in over.collect::<Vec<_>>() {
            self.wait(device, span);
        }
    }
}

/// A half-cycle as a second of its own.
fn span(t: &Telemetry, at_s: i64) -> TelemetrySpan {
    let heating = |x: i64| match heats(t) {
        true => Spread::of(x),
        false => Spread::default(),
    };
    TelemetrySpan {
        at_s,
        asked_w: t.asked_w,
        state: t.state as u8,
        pot: t.pot as u8,
        fault: t.fault.number(),
        power_mw: Spread::of(i64::from(t.power_mw)),
        i_crest_ma: Spread::of(i64::from(t.i_crest_ma)),
        r_uohm: heating(i64::from(t.r.0)),
        l_ph: heating(i64::from(t.l.0)),
        f_sw_hz: heating(i64::from(t.f_sw_hz)),
    }
}

impl Seconds {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Every change is complete in itself.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A half-cycle of a device came, at this time in milliseconds since 1970, UTC.
    pub fn push(&self, device: &str, t: &Telemetry, at_ms: i64) {
        let half_cycle = span(t, at_ms.div_euclid(1_000));
        let mut inner = self.lock();
        match inner.now.get_mut(device) {
            Some(now) if now.at_s == half_cycle.at_s => now.merge(&half_cycle),
            Some(now) => {
                let over = std::mem::replace(now, half_cycle);
                inner.wait(device.to_owned(), over);
            }
            None => {
                if inner.now.len() >= DEVICES {
                    inner.close_before(i64::MIN);
                }
                inner.now.insert(device.to_owned(), half_cycle);
            }
        }
    }

    /// Seconds that are over, to be written; those that are written already are given again until
    /// [`Seconds::written`] or [`Seconds::not_written`] is called. With `all` the present ones, too.
    pub fn take(&self, at_ms: i64, all: bool) -> Vec<TelemetrySecond> {
        let mut inner = self.lock();
        let now_s = if all {
            i64::MIN
        } else {
            at_ms.div_euclid(1_000)
        };
        inner.close_before(now_s);
        if inner.writing.is_empty() {
            inner.writing = std::mem::take(&mut inner.waiting).into();
        }
        inner.writing.clone()
    }

    /// What was taken is in the store.
    pub fn written(&self) {
        self.lock().writing.clear();
    }

    /// What was taken is not in the store, and waits on.
    pub fn not_written(&self) {
        let mut inner = self.lock();
        let mut waiting: VecDeque<_> = std::mem::take(&mut inner.writing).into();
        waiting.append(&mut inner.waiting);
        inner.waiting = waiting;
    }

    /// Seconds that were dropped because the store could not keep up.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// Seconds of a device that are not in the store, as far as is known here, oldest first.
    pub fn of(&self, device: &str) -> Vec<TelemetrySpan> {
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
    use ihd_shared::wire::messages::State;

    use super::*;
    use crate::states::tests::telemetry;

    #[test]
    fn half_cycles_become_seconds_that_wait_until_they_are_written() {
        let seconds = Seconds::default();
        let mut t = telemetry(State::Heating);
        t.f_sw_hz = 45_000;
        for k in 0..250u32 {
            t.power_mw = 1_000_000 + k;
            seconds.push("a", &t, 10_000 + 10 * i64::from(k));
        }
        seconds.push("b", &telemetry(State::Idle), 12_000);
        let of_a = seconds.of("a");
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
        assert_eq!(seconds.take(12_900, false).len(), 2);
        assert_eq!(seconds.of("a"), of_a, "until it is written it is here");
        seconds.not_written();
        let taken = seconds.take(13_000, false);
        assert_eq!(taken.len(), 4, "those of who fell silent, too");
        assert_eq!((taken[0].span.at_s, taken[3].device.as_str()), (10, "b"));
        seconds.push("a", &t, 13_000);
        seconds.written();
        assert_eq!(seconds.of("a").len(), 1);
        assert!(seconds.of("b").is_empty());
        assert_eq!(seconds.take(13_000, true).len(), 1, "at the end all");
    }

    #[test]
    fn what_the_store_does_not_take_is_bounded_and_counted() {
        let seconds = Seconds::default();
        let t = telemetry(State::Idle);
        // A store that takes nothing, and a day.
        for at_s in 0..86_400 {
            seconds.push("a", &t, at_s * 1_000);
            if at_s % 500 == 0 {
                seconds.take(at_s * 1_000, false);
                seconds.not_written();
            }
        }
        let waits = seconds.of("a");
        assert_eq!(waits.len(), WAITING + 1);
        assert_eq!(seconds.dropped(), 86_400 - WAITING as u64 - 1);
        assert_eq!(waits.last().unwrap().at_s, 86_399, "the oldest go first");
        for k in 0..1_000 {
            seconds.push(&format!("usb:{k}"), &t, 86_400_000);
        }
        assert!(seconds.lock().now.len() <= DEVICES);
        assert!(seconds.lock().waiting.len() <= WAITING);
    }
}
