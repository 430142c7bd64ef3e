//! Windows, devices and sessions to store.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use ihd_link::Window;
use ihd_shared::sampling::{Pair, Scales};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{FrontEnd, Hello};
use ihd_store::clock::Clock;
use ihd_store::{NewResult, Retention, SamplePolicy, SessionId, Store, StoreOptions};

/// 2026-11-22T12:00:00Z.
pub const NOON_MS: i64 = 1_795_348_800_000;

pub const DAY_MS: i64 = 86_400_000;

pub fn hello(boot: u32) -> Hello {
    ours(ROLE_DEVICE, 1, boot, "ihd-firmware 0.1.0", "sim")
}

pub const FRONT_END: FrontEnd = FrontEnd {
    v_full_scale_mv: 640_000,
    i_full_scale_ma: 80_000,
    bus_full_scale_mv: 450_000,
    mains_full_scale_mv: 450_000,
    bits: 12,
};

/// A window as a board sends it: sine waves in 12 bits with noise in the last ones, half a mains period of
/// them at 50 Hz, whatever the number other noise.
pub fn window(seq: u32) -> Window {
    sized(seq, 9_150)
}

/// A [`window`] with so many pairs.
pub fn sized(seq: u32, pairs: usize) -> Window {
    let mut noise = u64::from(seq).wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut bit = || {
        noise ^= noise << 13;
        noise ^= noise >> 7;
        noise ^= noise << 17;
        (noise >> 60) as f64 / 4.0 - 2.0
    };
    let pair = |k: usize| {
        let phase = k as f64 * 0.309;
        let envelope = (k as f64 / pairs as f64 * std::f64::consts::PI).sin();
        let (v, i) = (1_100.0 * phase.sin(), 900.0 * (phase - 1.2).sin());
        Pair {
            v: (envelope * v + bit()) as i16,
            i: (envelope * i + bit()) as i16,
        }
    };
    Window {
        seq,
        half_cycle: seq.wrapping_mul(20).wrapping_add(7),
        f_sw_hz: 45_000,
        half_cycle_ns: 10_000_123,
        first_pair_ns: -1_234,
        pairs: (0..pairs).map(pair).collect(),
        first_trajectory_ns: 33_333,
        trajectory: (0..pairs / 61)
            .map(|k| TrajectoryEntry {
                r: MicroOhm(2_345_678 + k as i32),
                l: PicoHenry(-(k as i32)),
            })
            .collect(),
        saturated: 3,
        lookup_version: 12,
        scales: Scales {
            v_full_scale_mv: 640_000,
            i_full_scale_ma: 80_000,
        },
    }
}

pub fn result(session: SessionId, seq: u32) -> NewResult {
    NewResult {
        session,
        seq,
        half_cycle: seq.wrapping_mul(20).wrapping_add(7),
        f_sw_hz: 45_000,
        i_crest_a: 31.25,
        power_w: Some(1_204.5),
        r_ohm: 2.345,
        l_h: 8.125e-5,
        sigma_r_pct: 0.25,
        sigma_l_pct: 0.125,
        pass: true,
        why: String::new(),
        changed_lookup: false,
        iterations: 321,
    }
}

pub fn keeping(keep: SamplePolicy, max_bytes: u64, max_age_days: Option<u32>) -> StoreOptions {
    StoreOptions {
        retention: Retention {
            max_age_days,
            max_bytes,
        },
        keep,
    }
}

/// The store in a folder, which must be whole.
pub fn open(folder: &Path, settings: &StoreOptions) -> Store {
    let opened = Store::open(folder, settings).unwrap();
    assert_eq!(opened.damage, []);
    opened.store
}

/// A session of boot 7 of the device "bench".
pub fn session(store: &mut Store) -> SessionId {
    let device = store.device("bench", "tcp:127.0.0.1:4711").unwrap();
    store.begin_session(device, &hello(7), &FRONT_END).unwrap()
}

/// A clock that is set.
#[derive(Clone)]
pub struct SetClock(Arc<AtomicI64>);

impl SetClock {
    pub fn at(ms: i64) -> Self {
        Self(Arc::new(AtomicI64::new(ms)))
    }

    pub fn forward(&self, ms: i64) {
        self.0.fetch_add(ms, Ordering::Relaxed);
    }

    pub fn clock(&self) -> Clock {
        let at = Arc::clone(&self.0);
        Arc::new(move || at.load(Ordering::Relaxed))
    }
}

/// Names of the folder's files, in order.
pub fn files(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = names
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Lets this much time pass in steps, in each of which a daemon would collect.
pub fn live(store: &mut Store, clock: &SetClock, ms: i64) {
    for _ in 0..ms / 1_200_000 {
        clock.forward(1_200_000);
        store.collect_garbage().unwrap();
    }
}
