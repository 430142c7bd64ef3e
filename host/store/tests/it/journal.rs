//! Events and commands as one journal, and what is kept beside windows.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_store::{
    Certainty, CurveSource, JournalFilter, NewEvent, SamplePolicy, Store, StoreOptions,
    StoreReader, StoredCurve,
};

use super::fixture::*;

#[test]
fn events_and_commands_are_one_journal_newest_first() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let opened =
        Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock()).unwrap();
    let mut store = opened.store;
    let bench = store.device("bench", "").unwrap();
    let other = store.device("other", "").unwrap();
    for k in 0..10 {
        clock.forward(1_000);
        store.event(Some(bench), "fault", &format!("{k}")).unwrap();
        clock.forward(1_000);
        store
            .audit(
                NOON_MS + 2_000 * (k + 1),
                Some(other),
                "me",
                "off",
                &format!("off {k}"),
            )
            .unwrap();
    }
    let event = |at_ms, device: &str, kind, text: &str| NewEvent {
        at_ms,
        device: device.to_owned(),
        kind,
        text: text.to_owned(),
    };
    // Told late, with times of their own; a device that the store does not know is nobody.
    store
        .keep_events(&[
            event(NOON_MS + 1_500, "bench", "pot", "lifted\u{1b}[31m"),
            event(NOON_MS + 30_000, "", "store", "full"),
            event(NOON_MS + 31_000, "stranger", "state", "searching"),
        ])
        .unwrap();
    // More in one millisecond than a page has.
    let at_once = [(); 5].map(|()| event(NOON_MS + 12_345, "bench", "pot", "moved"));
    store.keep_events(&at_once).unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let read = |filter: JournalFilter| reader.journal(&filter).unwrap();
    let all = read(JournalFilter::default());
    assert_eq!(all.len(), 28);
    assert!(all.is_sorted_by(|a, b| a.at_ms >= b.at_ms));
    assert_eq!(
        (
            all[0].kind.as_str(),
            all[0].device.as_deref(),
            all[0].text.as_str()
        ),
        ("state", None, "stranger: searching")
    );
    let command = &all[2];
    assert_eq!(
        (
            command.kind.as_str(),
            command.holder.as_str(),
            command.text.as_str(),
            command.outcome.as_str()
        ),
        ("command", "me", "off", "off 9")
    );
    let of = |device: &str| JournalFilter {
        device: Some(device.to_owned()),
        ..JournalFilter::default()
    };
    assert_eq!(read(of("bench")).len(), 16);
    assert!(
        !read(of("bench"))[14].text.contains('\u{1b}'),
        "nothing for a terminal"
    );
    assert_eq!(read(of("")).len(), 2, "the daemon's own");
    assert!(read(of("'; DROP TABLE events; --")).is_empty());
    let kind = |kind: &str| JournalFilter {
        kind: Some(kind.to_owned()),
        ..JournalFilter::default()
    };
    assert_eq!(read(kind("command")).len(), 10);
    assert_eq!(read(kind("fault")).len(), 10);
    // Page by page nothing is told twice and nothing is left out.
    let mut pages = Vec::new();
    let mut before_ms = None;
    loop {
        let page = read(JournalFilter {
            before_ms,
            limit: Some(4),
            ..JournalFilter::default()
        });
        let Some(last) = page.last() else { break };
        before_ms = Some(last.at_ms);
        pages.extend(page);
    }
    assert_eq!(pages, all);
    let since = read(JournalFilter {
        since_ms: Some(NOON_MS + 19_000),
        ..JournalFilter::default()
    });
    assert_eq!(since.len(), 4);
}

#[test]
fn how_well_cells_are_known_goes_with_their_lookup() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let device = store.device("bench", "").unwrap();
    let mut cells = [[0.0; 17]; 8];
    cells[3][5] = 0.8;
    cells[7][16] = 1.0;
    cells[0][0] = f64::NAN;
    let lookup = |version| RlLookup { version, ..prior() };
    let mut sigma = [[[0.0; 17]; 8]; 2];
    sigma[0][3][5] = 0.01234;
    sigma[0][0][0] = f64::NAN;
    sigma[1][7][16] = 99.0;
    let certainty = Certainty::quantise(&cells, &sigma);
    store
        .pend_lookup(device, &lookup(1), "", Some(&certainty))
        .unwrap();
    store.adopt_lookup(device, &lookup(1)).unwrap();
    store.pend_lookup(device, &lookup(2), "", None).unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let known = reader.certainty("bench", 1).unwrap().unwrap();
    let read = known.confidence();
    assert_eq!((read.len(), read[0].len()), (8, 17));
    assert!((read[3][5] - 0.8).abs() <= 0.5 / 255.0);
    assert_eq!((read[7][16], read[0][0], read[2][5]), (1.0, 0.0, 0.0));
    let [r, l] = known.sigma_pct().unwrap();
    assert_eq!((l.len(), l[7].len()), (8, 17));
    assert!((r[3][5] - 1.234).abs() <= 0.5e-2 && r[3][6] == 0.0 && l[3][5] == 0.0);
    // What is no number, and what is out of range, is not taken for a small deviation.
    assert!(r[0][0] > 600.0 && l[7][16] > 600.0);
    assert_eq!(reader.certainty("bench", 2).unwrap(), None);
    assert_eq!(reader.certainty("bench", 9).unwrap(), None);
    // A store of version 4, which knows no deviations, that nobody has opened for writing since.
    drop((reader, store));
    let records = rusqlite::Connection::open(folder.path().join("ihd.db")).unwrap();
    let drop_it = "ALTER TABLE lookups DROP COLUMN sigma; PRAGMA user_version = 4";
    records.execute_batch(drop_it).unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let known = reader.certainty("bench", 1).unwrap().unwrap();
    assert_eq!((known.confidence(), known.sigma_pct()), (read, None));
}

#[test]
fn curves_stay_and_go_with_their_windows_samples() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(
        folder.path(),
        &keeping(SamplePolicy::Informative, 1 << 30, None),
    );
    let session = session(&mut store);
    let ramp = |n: usize| (0..n).map(|k| 1.0 + k as f64).collect::<Vec<_>>();
    let curve = |n: usize| StoredCurve {
        t_s: ramp(n),
        r_ohm: ramp(n),
        l_h: ramp(n),
        i_a: ramp(n),
        ..StoredCurve::default()
    };
    for seq in [1, 2] {
        store.keep_window(session, &sized(seq, 300)).unwrap();
        store
            .keep_curve(session, seq, CurveSource::Truth, &curve(900))
            .unwrap();
    }
    // Told in another length, and told again.
    store
        .keep_curve(session, 1, CurveSource::Network, &curve(50))
        .unwrap();
    store
        .keep_curve(session, 1, CurveSource::Network, &curve(60))
        .unwrap();
    store
        .keep_curve(session, 9, CurveSource::Network, &curve(50))
        .unwrap();
    let reader = StoreReader::open(folder.path()).unwrap();
    let (row, window, curves) = reader.whole_window("bench", 7, 1).unwrap().unwrap();
    assert_eq!((row.seq, window.seq), (1, 1));
    assert_eq!(curves.network, Some(curve(60)));
    let truth = curves.truth.unwrap();
    assert_eq!(
        (truth.t_s.len(), truth.t_s[0], truth.t_s[127]),
        (128, 1.0, 900.0)
    );
    assert!(
        reader.whole_window("bench", 7, 9).unwrap().is_none(),
        "there is no such window"
    );
    // The second one tells nothing.
    store.record_result(&result(session, 2), None).unwrap();
    assert!(reader.whole_window("bench", 7, 2).unwrap().is_none());
    store
        .keep_curve(session, 2, CurveSource::Network, &curve(50))
        .unwrap();
    let rows = reader.last_windows("bench", 10, false).unwrap();
    assert_eq!(rows.iter().map(|r| r.seq).collect::<Vec<_>>(), [2, 1]);
    let whole = reader.last_windows("bench", 1, true).unwrap();
    assert_eq!(whole.iter().map(|r| r.seq).collect::<Vec<_>>(), [1]);
    drop(store);
    let day = files(folder.path())
        .into_iter()
        .find(|f| f.starts_with("windows-"))
        .unwrap();
    let connection = rusqlite::Connection::open(folder.path().join(day)).unwrap();
    let left: i64 = connection
        .query_row("SELECT count(*) FROM trajectories", [], |row| row.get(0))
        .unwrap();
    assert_eq!(left, 1, "of the first one");
}

#[test]
fn results_of_a_stretch_are_thinned_evenly_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let clock = SetClock::at(NOON_MS);
    let opened =
        Store::open_with_clock(folder.path(), &StoreOptions::default(), clock.clock()).unwrap();
    let mut store = opened.store;
    let session = session(&mut store);
    for seq in 0..100 {
        let mut result = result(session, seq);
        result.i_crest_a = 10.0 + f64::from(seq % 3);
        result.pass = seq % 10 != 9;
        store.record_result(&result, None).unwrap();
        clock.forward(1_000);
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    let within = (NOON_MS, NOON_MS + 100_000);
    let (of, some) = reader.results_between("bench", within, 10).unwrap();
    assert_eq!(of, 100);
    let seqs: Vec<_> = some.iter().map(|row| row.seq).collect();
    assert_eq!(seqs, [0, 10, 20, 30, 40, 50, 60, 70, 80, 90]);
    let (of, some) = reader
        .results_between("bench", (NOON_MS + 5_000, NOON_MS + 8_000), 10)
        .unwrap();
    assert_eq!((of, some.len(), some[0].seq), (3, 3, 5));
    assert_eq!(
        reader.results_between("nobody", within, 10).unwrap(),
        (0, vec![])
    );
    assert!(
        reader
            .result_of("bench", 7, 42)
            .unwrap()
            .is_some_and(|row| row.pass)
    );
    assert!(reader.result_of("bench", 7, 100).unwrap().is_none());
    // The last one that passed of each ampere.
    let taught = reader.last_accepted("bench", 0).unwrap();
    let mut last: Vec<_> = taught
        .iter()
        .map(|t| (t.i_crest_a as i64, (t.at_ms - NOON_MS) / 1_000))
        .collect();
    last.sort_unstable();
    assert_eq!(last, [(10, 96), (11, 97), (12, 98)]);
    let newest = taught.iter().map(|t| t.last).max().unwrap();
    assert!(reader.last_accepted("bench", newest).unwrap().is_empty());
}
