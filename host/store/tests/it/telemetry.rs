//! Telemetry of devices, second by second: stored whatever the policy for windows, read in seconds and minutes.

use std::time::Instant;

use ihd_store::{
    SamplePolicy, Spread, Store, StoreOptions, StoreReader, TelemetrySecond, TelemetrySpan,
};
use rusqlite::Connection;

use super::fixture::*;

const NOON_S: i64 = NOON_MS / 1_000;

/// A second of 100 half-cycles with this power in watt, heating or not.
fn second(device: &str, at_s: i64, power_w: i64, heats: bool) -> TelemetrySecond {
    let mut span = TelemetrySpan {
        at_s,
        asked_w: power_w as u16,
        state: if heats { 2 } else { 0 },
        pot: 2,
        ..TelemetrySpan::default()
    };
    for k in 0..100i64 {
        // Through one second the power rises by 99 mW.
        span.power_mw
            .merge(&Spread::from_value(power_w * 1_000 + k));
        span.i_crest_ma.merge(&Spread::from_value(30_000));
        if heats {
            span.r_uohm.merge(&Spread::from_value(2_500_000 - k));
            span.l_ph.merge(&Spread::from_value(28_000_000 + k));
            span.f_sw_hz.merge(&Spread::from_value(45_000));
        }
    }
    TelemetrySecond {
        device: device.to_owned(),
        span,
    }
}

fn all(
    reader: &StoreReader,
    device: &str,
    within: (i64, i64),
    minutes: bool,
) -> Vec<TelemetrySpan> {
    let mut spans = Vec::new();
    let mut take = |span| spans.push(span);
    reader
        .telemetry(device, within, minutes, &mut take)
        .unwrap();
    spans
}

#[test]
fn seconds_and_minutes_say_the_same_and_devices_stand_alone() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    // Windows are not kept at all, telemetry is.
    let settings = keeping(SamplePolicy::OneIn(1_000), 0, None);
    let opened = Store::open_with_clock(folder.path(), &settings, clock.clock()).unwrap();
    let mut store = opened.store;
    let seconds: Vec<_> = (0..90)
        .map(|k| second("a", NOON_S + k, 1_000 + k, k < 30))
        .chain([second("b", NOON_S, 7, false)])
        .collect();
    // In batches that cut a minute in two.
    for batch in seconds.chunks(7) {
        assert_eq!(store.keep_telemetry(batch).unwrap(), batch.len());
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    let seconds = all(&reader, "a", (NOON_S, NOON_S + 90), false);
    assert_eq!(seconds.len(), 90);
    assert_eq!(
        seconds[3].power_mw.min_mean_max(),
        Some([1_003_000.0, 1_003_050.0, 1_003_099.0])
    );
    assert_eq!(seconds[40].r_uohm.min_mean_max(), None, "it did not heat");
    let minutes = all(&reader, "a", (NOON_S, NOON_S + 90), true);
    assert_eq!(minutes.len(), 2);
    assert_eq!((minutes[0].at_s, minutes[0].half_cycles()), (NOON_S, 6_000));
    // Means of 1000 .. 1059 W, and of the half-cycles' 0 .. 99 mW rounded to the milliwatt.
    assert_eq!(
        minutes[0].power_mw.min_mean_max(),
        Some([1_000_000.0, 1_029_550.0, 1_059_099.0])
    );
    assert_eq!(minutes[0].r_uohm.count(), 3_000);
    assert_eq!(
        minutes[0].l_ph.min_mean_max().map(|l| l[2]),
        Some(28_000_099.0)
    );
    assert_eq!(
        (minutes[0].state, minutes[0].asked_w),
        (0, 1_059),
        "as it ended"
    );
    assert_eq!(minutes[1].half_cycles(), 3_000);
    assert_eq!(all(&reader, "b", (0, NOON_S + 90), false).len(), 1);
    assert!(all(&reader, "a", (NOON_S + 90, NOON_S + 900), false).is_empty());
    assert!(all(&reader, "nobody", (0, i64::MAX / 1_000), true).is_empty());
    let done = reader
        .telemetry("a", (NOON_S, NOON_S + 9), false, &mut |_| ())
        .unwrap();
    assert_eq!(
        done.last_s,
        Some(NOON_S + 89),
        "of the days, not of the stretch"
    );
}

#[test]
fn midnight_is_passed_and_retention_takes_the_day() {
    let folder = tempfile::tempdir().unwrap();
    let midnight_s = NOON_S + 12 * 3_600;
    let clock = SetClock::at(NOON_MS);
    let settings = keeping(SamplePolicy::All, 1 << 30, Some(1));
    let opened = Store::open_with_clock(folder.path(), &settings, clock.clock()).unwrap();
    let mut store = opened.store;
    store
        .keep_telemetry(&[second("a", NOON_S, 1, true)])
        .unwrap();
    clock.forward(12 * 3_600_000 + 2_000);
    let around: Vec<_> = (-3..3)
        .map(|k| second("a", midnight_s + k, 1, true))
        .collect();
    assert_eq!(store.keep_telemetry(&around).unwrap(), 6);
    // Of a day that nobody has open: not stored, and said so.
    assert_eq!(
        store
            .keep_telemetry(&[second("a", NOON_S - 5 * 86_400, 1, true)])
            .unwrap(),
        0
    );
    let reader = StoreReader::open(folder.path()).unwrap();
    let within = (midnight_s - 60, midnight_s + 60);
    let minutes = all(&reader, "a", within, true);
    assert_eq!(
        minutes.iter().map(|m| m.half_cycles()).collect::<Vec<_>>(),
        [300, 300]
    );
    assert_eq!(
        files(folder.path())
            .iter()
            .filter(|f| f.ends_with(".db"))
            .count(),
        3
    );
    store.collect_garbage().unwrap();
    live(&mut store, &clock, 2 * DAY_MS);
    assert!(
        all(&reader, "a", within, true).is_empty(),
        "gone with their days"
    );
}

#[test]
fn a_second_that_is_told_twice_is_one_and_the_fuller_one_stays() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = {
        let clock = SetClock::at(NOON_MS);
        let settings = StoreOptions::default();
        Store::open_with_clock(folder.path(), &settings, clock.clock())
            .unwrap()
            .store
    };
    let full = second("a", NOON_S, 1_000, true);
    let mut part = second("a", NOON_S, 500, true);
    part.span.power_mw = Spread::from_value(500_000);
    for told in [&part, &full, &part, &full] {
        store.keep_telemetry(std::slice::from_ref(told)).unwrap();
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    for minutes in [false, true] {
        let spans = all(&reader, "a", (NOON_S, NOON_S + 1), minutes);
        assert_eq!(spans.len(), 1);
        assert_eq!(spans[0].half_cycles(), 100);
    }
}

#[test]
fn a_day_of_an_earlier_ihd_is_read_and_brought_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    {
        let mut store = open(folder.path(), &StoreOptions::default());
        let session = session(&mut store);
        store.keep_window(session, &sized(1, 300)).unwrap();
        store.record_result(&result(session, 1), None).unwrap();
    }
    let day = folder.path().join(
        files(folder.path())
            .into_iter()
            .find(|f| f.starts_with("windows-") && f.ends_with(".db"))
            .unwrap(),
    );
    // As version 1 left them.
    for (path, sql) in [
        (
            day,
            "DROP TABLE telemetry; DROP TABLE trajectories; DROP INDEX windows_due;
             DROP INDEX windows_with_samples; DROP INDEX windows_at_fleet; ALTER TABLE windows DROP COLUMN fleet_end;
             ALTER TABLE windows DROP COLUMN fleet_ms; ALTER TABLE windows DROP COLUMN fleet;",
        ),
        (
            folder.path().join("ihd.db"),
            "DROP INDEX events_in_time; DROP INDEX audit_in_time;
             ALTER TABLE lookups DROP COLUMN confidence; ALTER TABLE lookups DROP COLUMN sigma; DROP TABLE fleet;
             DROP TABLE used; DROP TABLE alloys;
             ALTER TABLE devices DROP COLUMN chip;",
        ),
    ] {
        let connection = Connection::open(path).unwrap();
        connection.execute_batch(sql).unwrap();
        connection.pragma_update(None, "user_version", 1).unwrap();
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    assert!(reader.window("bench", 7, 1).unwrap().is_some());
    let (_, _, curves) = reader.whole_window("bench", 7, 1).unwrap().unwrap();
    assert_eq!(curves, ihd_store::Curves::default());
    assert!(all(&reader, "bench", (0, i64::MAX / 1_000), false).is_empty());
    assert_eq!(reader.certainty("bench", 1).unwrap(), None);
    drop(reader);
    let mut store = open(folder.path(), &StoreOptions::default());
    let now_s = store.results(&Default::default()).unwrap()[0].at_ms / 1_000;
    store
        .keep_telemetry(&[second("bench", now_s, 1, true)])
        .unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    assert_eq!(all(&reader, "bench", (now_s, now_s + 1), false).len(), 1);
    // Windows of before are not a fleet's.
    assert_eq!(store.count_due().unwrap(), 0);
}

/// Prints the size of four devices' telemetry and the time to read one: two hours, or a day with `IHD_STORE_DAY`.
#[test]
fn a_day_is_read_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let midnight_s = NOON_S - 12 * 3_600;
    let clock = SetClock::at(NOON_MS);
    let opened =
        Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock()).unwrap();
    let mut store = opened.store;
    let hours = if std::env::var_os("IHD_STORE_DAY").is_some() {
        24
    } else {
        2
    };
    let devices = ["bench-1", "bench-2", "bench-3", "bench-4"];
    let began = Instant::now();
    for minute in 0..hours * 60 {
        let seconds = (0..60).flat_map(|s| {
            let at_s = midnight_s + minute * 60 + s;
            devices.map(|device| second(device, at_s, 1_000 + (at_s * 7919) % 977, true))
        });
        store.keep_telemetry(&seconds.collect::<Vec<_>>()).unwrap();
    }
    let wrote = began.elapsed();
    store.collect_garbage().unwrap();
    let bytes: u64 = files(folder.path())
        .iter()
        .filter(|f| f.starts_with("windows-"))
        .map(|f| std::fs::metadata(folder.path().join(f)).unwrap().len())
        .sum();
    let reader = StoreReader::open(folder.path()).unwrap();
    let day = (midnight_s, midnight_s + 86_400);
    let began = Instant::now();
    let minutes = all(&reader, "bench-2", day, true).len();
    let read_minutes = began.elapsed();
    let began = Instant::now();
    let seconds = all(&reader, "bench-2", day, false).len();
    let read_seconds = began.elapsed();
    assert_eq!(
        (minutes, seconds),
        (hours as usize * 60, hours as usize * 3_600)
    );
    println!(
        "{hours} h of 4 devices: {bytes} bytes, written in {wrote:?}; one device read in minutes in {read_minutes:?}, in seconds in {read_seconds:?}"
    );
    let rows = seconds as u64 * 4;
    assert!(
        (50..160).contains(&(bytes / rows)),
        "{} bytes a row",
        bytes / rows
    );
}
