//! Files of scopes, MATLAB and NumPy, opened as captures. tests/fixtures/formats/make.py states who
//! wrote each file; the waveform is the formula of [`wave`].

use std::fs;
use std::path::{Path, PathBuf};

use ihd_capture::channels::{ChannelOptions, ChannelRef};
use ihd_capture::{OpenOptions, open};
use ihd_signal::{Capture, TimeBase};

const SAMPLES: usize = 300;
const DT_S: f64 = 0.5e-6;
const T0_S: f64 = -75e-6;
/// Steps of the 16-bit files.
const V_STEP: f64 = 200.0 / 32768.0;
const I_STEP: f64 = 40.0 / 32768.0;

fn wave(k: usize) -> (f64, f64) {
    let t_s = T0_S + k as f64 * DT_S;
    let angle = std::f64::consts::TAU * 45e3 * t_s;
    let v_v = 150.0 * angle.sin() + 20.0 * (3.0 * angle).sin();
    (v_v, 30.0 * (angle - 1.2).sin())
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/formats")
        .join(name)
}

fn opened(file: &str, options: &OpenOptions) -> Capture {
    open(&fixture(file), options).unwrap_or_else(|e| panic!("{file}: {e}"))
}

fn pair(first: &str, second: &str) -> Capture {
    let options = OpenOptions {
        second: Some(fixture(second)),
        ..OpenOptions::default()
    };
    opened(first, &options)
}

fn alone(file: &str) -> Capture {
    opened(file, &OpenOptions::default())
}

/// The options that name channels by what the user would type.
fn channels(v: &str, i: &str) -> ChannelOptions {
    ChannelOptions {
        channels: Some([ChannelRef::parse(v), ChannelRef::parse(i)]),
        ..ChannelOptions::default()
    }
}

/// Compares with the formula; `v_error_v` and `i_error_a` are what the file's resolution allows.
fn check(what: &str, capture: &Capture, v_error_v: f64, i_error_a: f64) {
    assert_eq!(capture.v_v.len(), SAMPLES, "{what}");
    assert_eq!(capture.i_a.len(), SAMPLES, "{what}");
    for k in 0..SAMPLES {
        let (v_v, i_a) = wave(k);
        let (v, i) = (f64::from(capture.v_v[k]), f64::from(capture.i_a[k]));
        // f32 has 24 bits.
        let (v_error_v, i_error_a) = (v_error_v + 2e-5, i_error_a + 4e-6);
        assert!(
            (v - v_v).abs() < v_error_v,
            "{what}, sample {k}: {v} V, not {v_v} V"
        );
        assert!(
            (i - i_a).abs() < i_error_a,
            "{what}, sample {k}: {i} A, not {i_a} A"
        );
    }
}

fn check_time(what: &str, capture: &Capture, t0_s: f64) {
    let TimeBase::Even {
        t0_s: begin_s,
        dt_s,
    } = capture.time
    else {
        panic!("{what}: not even");
    };
    assert!((dt_s / DT_S - 1.0).abs() < 1e-6, "{what}: {dt_s:e}");
    assert!((begin_s - t0_s).abs() < 1e-3 * DT_S, "{what}: {begin_s:e}");
}

#[test]
fn tektronix_wfm_of_every_version_and_byte_order() {
    for (v, i) in [
        ("tek_wfm1le_v.wfm", "tek_wfm2le_i.wfm"),
        ("tek_wfm1be_v.wfm", "tek_wfm3le_i.wfm"),
        ("tek_wfm2le_v.wfm", "tek_wfm2le_i.wfm"),
        ("tek_wfm2be_v.wfm", "tek_wfm2le_i.wfm"),
        ("tek_wfm3le_v.wfm", "tek_wfm3le_i.wfm"),
        ("tek_wfm3be_v.wfm", "tek_wfm3le_i.wfm"),
    ] {
        let capture = pair(v, i);
        check(v, &capture, 0.5 * V_STEP, 0.5 * I_STEP);
        // As tm_data_types, which wrote them, reads them: its tt_offset of 0.5 stands for nothing.
        check_time(v, &capture, T0_S);
        let full_v = capture.v_full_scale_v.unwrap();
        assert!((full_v - 200.0).abs() < 1e-9, "{v}: {full_v}");
        assert!((capture.i_full_scale_a.unwrap() - 40.0).abs() < 1e-9, "{v}");
    }
    // The order of the files does not matter: the units decide.
    let swapped = pair("tek_wfm3le_i.wfm", "tek_wfm3le_v.wfm");
    check("swapped", &swapped, 0.5 * V_STEP, 0.5 * I_STEP);
}

#[test]
fn tektronix_isf_in_long_and_short_form() {
    let capture = pair("tek_isf_v.isf", "tek_isf_i.isf");
    check("16 bit", &capture, 0.51 * V_STEP, 0.51 * I_STEP);
    check_time("16 bit", &capture, T0_S);
    let capture = pair("tek_isf_8bit_v.isf", "tek_isf_i.isf");
    check("8 bit", &capture, 0.51 * 256.0 * V_STEP, 0.51 * I_STEP);
    assert_eq!(capture.metadata["format"], "Tektronix ISF");
}

#[test]
fn lecroy_trc_in_both_byte_orders() {
    for v in ["lecroy_v.trc", "lecroy_be_v.trc"] {
        let capture = pair(v, "lecroy_i.trc");
        check(v, &capture, 0.52 * V_STEP, 0.52 * I_STEP);
        check_time(v, &capture, T0_S);
        assert_eq!(capture.metadata["instrument"], "LECROYHDO6104");
    }
}

#[test]
fn matlab_and_numpy() {
    check("plain.mat", &alone("plain.mat"), 0.0, 0.0);
    check("compressed.mat", &alone("compressed.mat"), 0.0, 0.0);
    let pico = OpenOptions {
        channels: channels("A", "B"),
        ..OpenOptions::default()
    };
    for (file, options) in [
        ("plain.mat", &OpenOptions::default()),
        ("compressed.mat", &OpenOptions::default()),
        ("picoscope.mat", &pico),
        ("plain.npz", &OpenOptions::default()),
        ("compressed.npz", &OpenOptions::default()),
    ] {
        let capture = opened(file, options);
        check(file, &capture, 0.0, 0.0);
        check_time(file, &capture, T0_S);
    }
}

#[test]
fn tables_in_the_dialects_of_scopes() {
    // File, format reported, error by its decimals in volt and ampere.
    for (file, maker, v_error_v, i_error_a) in [
        ("tektronix_mso.csv", "CSV, Tektronix", 5e-5, 5e-6),
        ("rigol.csv", "CSV, Rigol", 0.5, 0.05),
        ("rigol_mso5000.csv", "CSV, Rigol", 5e-6, 5e-6),
        ("siglent.csv", "CSV, Siglent", 5e-6, 5e-6),
        ("keysight.csv", "CSV, Keysight", 5e-4, 5e-5),
    ] {
        let capture = alone(file);
        check(file, &capture, v_error_v, i_error_a);
        check_time(file, &capture, T0_S);
        assert_eq!(capture.metadata["format"], maker);
    }
    for file in ["picoscope.csv", "picoscope_german.csv"] {
        let capture = alone(file);
        check(file, &capture, 5e-6, 5e-6);
        check_time(file, &capture, T0_S);
        assert_eq!(capture.metadata["format"], "CSV, PicoScope", "{file}");
    }
}

#[test]
fn tables_with_one_channel_in_pairs() {
    for (v, i, v_error_v, i_error_a) in [
        (
            "tektronix_v.csv",
            "tektronix_i.csv",
            0.5 * V_STEP,
            0.5 * I_STEP,
        ),
        ("tektronix_tds_v.csv", "tektronix_tds_i.csv", 5e-6, 5e-6),
        (
            "keysight_infiniium_v.csv",
            "keysight_infiniium_i.csv",
            5e-5,
            5e-6,
        ),
        // No unit in these: the files' names decide.
        ("lecroy_voltage.csv", "lecroy_current.csv", 5e-5, 5e-6),
    ] {
        let capture = pair(v, i);
        check(v, &capture, v_error_v, i_error_a);
        check_time(v, &capture, T0_S);
    }
}

#[test]
fn flags_say_what_files_do_not() {
    let asked = open(&fixture("picoscope.mat"), &OpenOptions::default()).unwrap_err();
    let asked = asked.to_string();
    assert!(
        asked.contains("picoscope.mat") && asked.contains("--input channels"),
        "{asked}"
    );
    let one = open(&fixture("tek_wfm3le_v.wfm"), &OpenOptions::default()).unwrap_err();
    assert!(one.to_string().contains("one channel only"), "{one}");
    let options = OpenOptions {
        channels: ChannelOptions {
            probe: Some([2.0, 0.5]),
            invert_v: true,
            swap: true,
            ..channels("CH1", "CH2")
        },
        ..OpenOptions::default()
    };
    let capture = opened("siglent.csv", &options);
    let (v_v, i_a) = wave(7);
    // Exchanged: the voltage comes from the current's column, doubled and inverted.
    assert!((f64::from(capture.v_v[7]) + 2.0 * i_a).abs() < 1e-4);
    assert!((f64::from(capture.i_a[7]) - 0.5 * v_v).abs() < 1e-4);
    let another = OpenOptions {
        second: Some(fixture("lecroy_i.trc")),
        ..OpenOptions::default()
    };
    let capture = opened("tek_isf_v.isf", &another);
    check("ISF with TRC", &capture, 0.51 * V_STEP, 0.52 * I_STEP);
    // Half an interval beside the other's samples.
    let beside = OpenOptions {
        second: Some(fixture("tek_isf_i.isf")),
        ..OpenOptions::default()
    };
    let dir = tempfile::tempdir().unwrap();
    let later = dir.path().join("later.wfm");
    fs::write(&later, half_an_interval_later("tek_wfm3le_v.wfm")).unwrap();
    let refused = open(&later, &beside).unwrap_err().to_string();
    assert!(
        refused.contains("tek_isf_i.isf") && refused.contains("0.5"),
        "{refused}"
    );
}

/// A little-endian WFM file whose time axis (scale, then offset, as doubles) begins half an interval later.
fn half_an_interval_later(file: &str) -> Vec<u8> {
    let mut bytes = fs::read(fixture(file)).unwrap();
    let axis = [DT_S.to_le_bytes(), T0_S.to_le_bytes()].concat();
    let at = bytes.windows(16).position(|b| b == axis).unwrap();
    bytes[at + 8..at + 16].copy_from_slice(&(T0_S + 0.5 * DT_S).to_le_bytes());
    bytes
}

/// Tektronix' own files, beside the project; `None` where they are absent.
fn vendor(file: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/captures/tektronix");
    if root.is_dir() {
        Some(root.join(file))
    } else {
        println!("skipped: no {}", root.display());
        None
    }
}

#[test]
fn one_waveform_in_three_files_of_the_vendor() {
    let Some(wfm) = vendor("analog_waveform.wfm") else {
        return;
    };
    for other in [
        "analog_waveform.csv",
        "analog_waveform.mat",
        "analog_waveform.wfm",
    ] {
        let options = OpenOptions {
            second: vendor(other),
            channels: ChannelOptions {
                probe: Some([1.0, 1.0]),
                ..channels("1", "2")
            },
            ..OpenOptions::default()
        };
        let capture = open(&wfm, &options).unwrap_or_else(|e| panic!("{other}: {e}"));
        assert_eq!(capture.len(), 50_000, "{other}");
        for (k, (a, b)) in capture.v_v.iter().zip(&capture.i_a).enumerate() {
            // The CSV has 9 figures of up to 0.6 V.
            assert!((a - b).abs() < 1e-7, "{other}, sample {k}: {a} and {b}");
        }
        // The CSV's first time.
        assert!((capture.time.at(0).unwrap() + 9.999_664_06e-7).abs() < 1e-14);
    }
}

#[test]
fn the_vendors_invalid_files_are_refused() {
    if vendor("").is_none() {
        return;
    }
    for file in [
        "invalid/invalid_csv.csv",
        "invalid/invalid_record_length.csv",
        "invalid/invalid_format.wfm",
        "invalid/invalid_tekmeta.wfm",
        "digital_waveform.wfm",
        "iq_waveform.wfm",
        "AM_1Mhz.wfm",
    ] {
        let path = vendor(file).unwrap();
        let options = OpenOptions {
            second: Some(path.clone()),
            channels: ChannelOptions {
                probe: Some([1.0, 1.0]),
                ..channels("1", "2")
            },
            ..OpenOptions::default()
        };
        let refused = open(&path, &options).map(|c| c.len());
        let text = refused.expect_err(file).to_string();
        println!("{text}");
        let place = text.contains(" byte ") || text.contains(" line ");
        assert!(text.contains(path.to_str().unwrap()) && place, "{text}");
    }
}
