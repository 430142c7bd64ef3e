//! Windows leave the store as files whose samples are the same, bit for bit.

use std::path::Path;

use ihd_capture::mcap::SessionReader;
use ihd_capture::{OpenOptions, open as open_capture};
use ihd_link::{DeviceEvent, Window};
use ihd_store::export::{ExportFormat, windows};
use ihd_store::{SamplePolicy, StoreError, StoreOptions, StoreReader, WindowFilter};

use super::fixture::*;

fn export(folder: &Path, filter: &WindowFilter, format: ExportFormat, to: &Path) -> Vec<String> {
    let reader = StoreReader::open(folder).unwrap();
    let written = windows(&reader, filter, format, to, &mut || ()).unwrap();
    let names = written
        .files
        .iter()
        .map(|path| path.file_name().unwrap().to_str().unwrap());
    names.map(str::to_owned).collect()
}

/// The samples as a capture holds them: codes times volt or ampere a code, in f32.
fn as_capture(windows: &[Window]) -> (Vec<f32>, Vec<f32>) {
    let single = |x: f64| x as f32;
    (
        windows
            .iter()
            .flat_map(|w| w.v_volt())
            .map(single)
            .collect(),
        windows
            .iter()
            .flat_map(|w| w.i_ampere())
            .map(single)
            .collect(),
    )
}

#[test]
fn a_recording_of_a_boot_gives_its_windows_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(folder.path(), &StoreOptions::default());
    let bench = session(&mut store);
    let stored: Vec<Window> = [3, 4, 9].map(window).into();
    for window in &stored {
        store.keep_window(bench, window).unwrap();
    }
    let device = store.device("../kitchen \u{1b}", "sim").unwrap();
    let kitchen = store.begin_session(device, &hello(9), &FRONT_END).unwrap();
    // The largest that there are: 50 Hz at 80 kHz.
    let large = sized(1, 16_267);
    store.keep_window(kitchen, &large).unwrap();
    let out = folder.path().join("out");
    let names = export(
        folder.path(),
        &WindowFilter::default(),
        ExportFormat::Mcap,
        &out,
    );
    assert_eq!(names, ["_kitchen__u_1b_-9.mcap", "bench-7.mcap"]);
    for (name, wanted) in [
        ("bench-7.mcap", &stored[..]),
        ("_kitchen__u_1b_-9.mcap", &[large]),
    ] {
        let path = out.join(name);
        let mut recording = SessionReader::open(&path).unwrap();
        assert_eq!(recording.hello().build, "ihd-firmware 0.1.0");
        let mut back = Vec::new();
        while let Some(event) = recording.next_event().unwrap() {
            match event {
                DeviceEvent::Window(window) => back.push(*window),
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(back, wanted, "{name}");
        let counters = recording.counters();
        assert_eq!((counters.frames_bad, counters.frames_lost), (0, 0));
        let capture = open_capture(&path, &OpenOptions::default()).unwrap();
        assert!(
            (capture.v_v.clone(), capture.i_a.clone()) == as_capture(wanted),
            "{name}"
        );
        assert_eq!(capture.v_full_scale_v, Some(640.0));
    }
}

#[test]
fn each_window_is_a_file_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = open(
        folder.path(),
        &keeping(SamplePolicy::OneIn(2), 1 << 30, None),
    );
    let bench = session(&mut store);
    for seq in 0..4 {
        store.keep_window(bench, &window(seq)).unwrap();
    }
    for (format, ending) in [(ExportFormat::Csv, "csv"), (ExportFormat::Npz, "npz")] {
        let out = folder.path().join(ending);
        let names = export(folder.path(), &WindowFilter::default(), format, &out);
        assert_eq!(
            names,
            [format!("bench-7-0.{ending}"), format!("bench-7-2.{ending}")]
        );
        let capture = open_capture(&out.join(&names[1]), &OpenOptions::default()).unwrap();
        assert!(
            (capture.v_v, capture.i_a) == as_capture(&[window(2)]),
            "{ending}"
        );
        let first_s = capture.time.at(0).unwrap();
        assert!((first_s + 1_234e-9).abs() < 1e-10, "{first_s:e}");
    }
    let reader = StoreReader::open(folder.path()).unwrap();
    let all = WindowFilter::default();
    let one = WindowFilter {
        seq: Some(2),
        ..WindowFilter::default()
    };
    let file = folder.path().join("one.csv");
    let written = windows(&reader, &one, ExportFormat::Csv, &file, &mut || ()).unwrap();
    assert_eq!((written.files, written.windows), (vec![file.clone()], 1));
    let again = windows(&reader, &one, ExportFormat::Csv, &file, &mut || ());
    assert!(matches!(again, Err(StoreError::Exists { .. })));
    let two = windows(
        &reader,
        &all,
        ExportFormat::Csv,
        &folder.path().join("two.csv"),
        &mut || (),
    );
    assert!(matches!(two, Err(StoreError::NotOneFile { files: 2, .. })));
    let counted = windows(
        &reader,
        &all,
        ExportFormat::Mcap,
        &folder.path().join("m"),
        &mut || (),
    );
    assert_eq!(counted.unwrap().without_samples, 2);
}
