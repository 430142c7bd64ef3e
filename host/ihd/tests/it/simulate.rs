//! `ihd simulate` as a user calls it.

use std::path::Path;

use assert_cmd::Command;
use ihd_capture::mcap;
use ihd_sim::recording::file::SETTINGS_KEY;
use ihd_sim::recording::run::record;
use ihd_sim::recording::settings::CaptureSpec;

fn simulate(dir: &Path, args: &[&str]) -> std::process::Output {
    let mut command = Command::cargo_bin("ihd").expect("the ihd binary is built with its tests");
    command
        .current_dir(dir)
        .env_remove("RUST_BACKTRACE")
        .arg("simulate")
        .args(args);
    command.output().expect("ihd runs")
}

#[test]
fn writes_a_recording_and_a_figure_and_repeats_to_the_last_digit() {
    let dir = tempfile::tempdir().unwrap();
    let args = "--set fsw=45k,mains=60,pot=ferritic-18,snr=30,rate=50M --seed 1 --set duration=1ms";
    for (name, ending) in [("a", "svg"), ("b", "png")] {
        let (out, plot) = (format!("{name}.mcap"), format!("{name}.{ending}"));
        let mut all: Vec<_> = args.split(' ').collect();
        all.extend(["--out", &out, "--plot", &plot]);
        let result = simulate(dir.path(), &all);
        let stdout = String::from_utf8_lossy(&result.stdout);
        assert!(
            result.status.success(),
            "{}",
            String::from_utf8_lossy(&result.stderr)
        );
        assert!(stdout.contains("resonance"), "{stdout}");
    }
    let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert_eq!(read("a.mcap"), read("b.mcap"));
    let stored = mcap::read(&dir.path().join("a.mcap")).unwrap();
    assert_eq!(stored.v_v.len(), 50_000);
    let settings: CaptureSpec = serde_json::from_str(&stored.metadata[SETTINGS_KEY]).unwrap();
    assert_eq!(settings.mains_hz, 60.0);
    assert_eq!(settings.pot.diameter_m, 0.18);
    assert!(String::from_utf8(read("a.svg")).unwrap().contains("<svg"));
    assert!(read("b.png").starts_with(b"\x89PNG\r\n\x1a\n"));
}

/// Not physics: these digits were printed on the first machine (x86-64, AVX-512), and every other
/// machine has to print them too. A change of the model changes them on purpose.
#[test]
fn the_digits_are_the_same_on_every_machine() {
    let settings = CaptureSpec {
        duration_s: 0.5e-3,
        ..CaptureSpec::default()
    };
    let truth = record(&settings, |_| ()).unwrap().truth;
    let last = truth.last().unwrap();
    let digits = format!("{:e} {:e} {:e}", last.r_ohm[0], last.l_h[0], last.i_a);
    assert_eq!(
        digits,
        "3.9379842408843557e0 2.836846393869642e-5 5.085596434067327e0"
    );
}

#[test]
fn the_clipped_range_shows_as_saturated_codes() {
    let dir = tempfile::tempdir().unwrap();
    let args = "--set load=behavioural,start=5ms,duration=1ms,bits=8,gain=4,4,spikes=1k -o a.mcap";
    let result = simulate(dir.path(), &args.split(' ').collect::<Vec<_>>());
    assert!(
        result.status.success(),
        "{}",
        String::from_utf8_lossy(&result.stderr)
    );
    let stored = mcap::read(&dir.path().join("a.mcap")).unwrap();
    let top = stored
        .i_a
        .iter()
        .filter(|i| **i >= 80.0 * 127.0 / 128.0)
        .count();
    assert!(top > 1000, "{top}");
    assert!(stored.i_a.iter().all(|i| i.abs() <= 80.0));
}

#[test]
fn disturbances_are_what_the_options_say() {
    let dir = tempfile::tempdir().unwrap();
    let args = "--set load=behavioural,duration=1ms,sweep=1k,500,duty=.35,bridge-resistance=20m,neighbour=1.2k,8 \
                --set poles=0,1M,droop=100,saturation=120,full-scale=800,100,at=0.5ms:load=.6,1.35 --out a.mcap";
    let result = simulate(dir.path(), &args.split_whitespace().collect::<Vec<_>>());
    let stderr = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{stderr}");
    let stored = mcap::read(&dir.path().join("a.mcap")).unwrap();
    let s: CaptureSpec = serde_json::from_str(&stored.metadata[SETTINGS_KEY]).unwrap();
    let sweep = s.sweep.map(|s| (s.deviation_hz, s.rate_hz));
    let neighbour = s.neighbour.map(|n| (n.offset_hz, n.v));
    assert_eq!((sweep, neighbour), (Some((1e3, 500.0)), Some((1.2e3, 8.0))));
    assert_eq!((s.duty, s.bridge_r_ohm, s.events.len()), (0.35, 0.02, 1));
    let sensing = &s.sensing;
    assert_eq!((sensing.v_pole_hz, sensing.i_pole_hz), (0.0, 1e6));
    assert_eq!((sensing.i_droop_hz, sensing.i_saturation_a), (100.0, 120.0));
    assert_eq!(
        (stored.v_full_scale_v, stored.i_full_scale_a),
        (Some(800.0), Some(100.0))
    );
    assert!(stored.f_sw.is_empty(), "a moving carrier states no steps");
}

#[test]
fn bad_input_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    for (args, word) in [
        ("--set rate=1M", "rate_hz"),
        ("--set fsw=NaN", "--set fsw=NaN"),
        ("--set fsw=5k", "f_sw_hz"),
        ("--set pot=wood-18", "unknown pot"),
        ("--set offset=500mm", "offset_m"),
        ("--set lift=-1mm", "lift_m"),
        ("--set temperature=NaN", "temperature_c"),
        ("--set bits=20", "bits"),
        ("--set step=1us", "dt_s"),
        ("paper-55", "paper-60"),
        ("--set at=3ms:pot=x", "unknown pot"),
        ("--set at=30ms:off", "event time_s"),
        ("--set bus-capacitance=-1", "bus_capacitance_f"),
        ("--set dead-time=5us", "dead_s"),
        ("--set snr=NaN", "snr_db"),
        ("--set duration=0", "duration_s"),
        ("--set duty=.1", "duty"),
        ("--set sweep=5k", "2 numbers"),
        ("--set sweep=20k,100", "deviation_hz"),
        ("--set neighbour=1k,500", "neighbour v"),
        ("--set poles=1,1M", "v_pole_hz"),
        ("--set droop=-1", "i_droop_hz"),
        ("--set saturation=.1", "i_saturation_a"),
        ("--set at=3ms:load=2", "2 numbers"),
        ("--set at=3ms:load=2,1", "r_factor"),
        ("--out x.csv", "ihd convert x.mcap --out x.csv"),
    ] {
        let result = simulate(dir.path(), &args.split(' ').collect::<Vec<_>>());
        let stderr = String::from_utf8_lossy(&result.stderr);
        assert!(!result.status.success(), "{args} was accepted");
        assert!(stderr.contains(word), "{args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{args}: {stderr}");
    }
}
