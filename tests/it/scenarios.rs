//! Every scenario of tests/scenarios against the limits in its file; docs/control.md shows what came of all variants.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use ihd_shared::board;
use ihd_sim::scenario::record::Record;
use ihd_sim::scenario::run::run;
use ihd_sim::scenario::variants::Variant;

use super::document;
use super::scenario_table::{ScenarioTable, read};

/// Two kinds of tests for each family: the first variant of each file, and all of them with the family's table.
macro_rules! scenarios {
    ($($family:ident { $($file:ident)+ })+) => {
        const FILES: &[&str] = &[$($(concat!(stringify!($family), "/", stringify!($file))),+),+];

        $(mod $family {
            $(#[test]
            fn $file() {
                super::first_variant(concat!("scenarios/", stringify!($family), "/", stringify!($file)));
            })+

            #[test]
            fn table_of_all_variants() {
                super::all_variants("scenarios", stringify!($family), &[$(stringify!($file)),+]);
            }
        })+
    };
}

scenarios! {
    absent { give_up no_pot put_on unsuitable }
    bursts { bursts pots }
    lift { lift shift }
    link { pots small small_mains stop_at_crest trip_at_crest unsuitable }
    mains { low_then_high short_swell }
    noise { snr_20 snr_25 snr_30 tolerances }
    objects { below_pot cutlery refused rings sandwich sheets smallest }
    panel { host_silent key_lock levels off_wins }
    plausibility { aged_capacitor bare_coil bits dead_comparator gain_drift gains glitch mains_hz no_drift off offsets sampling_ends sampling_stops slow_drift stuck supply timing unseen }
    pots { places recovered_mains risen_mains }
    restart { doubled host_clears host_repeats lookups person tries }
    sags { dip dropout swell unplugged }
    steps { dither low_mains steps taught }
    temperatures { derating empty_pan glass keep_warm oil over sensors water }
    unattended { boost boost_of_host host level timer touch }
    zvs { powers }
}

/// Folder of tests/.
fn directory(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Runs a variant with the firmware's library.
fn run_library(variant: &Variant) -> Record {
    run(&variant.scenario, |_| ()).unwrap_or_else(|e| panic!("{}: {e}", variant.name))
}

fn first_variant(name: &str) {
    let mut table = ScenarioTable::new("scenario", run_library);
    table.run(name, &read(name)[..1]);
    table.finish();
}

fn all_variants(folder: &str, family: &str, files: &[&str]) {
    let mut table = ScenarioTable::new("scenario", run_library);
    for file in files {
        let name = format!("{folder}/{family}/{file}");
        table.run(&name, &read(&name));
    }
    let mark = format!("scenarios {family}");
    let command = "cargo nextest run -p ihd-tests --ignore-default-filter scenarios";
    document::hold("control.md", &mark, &table.finish(), command);
}

#[test]
fn every_file_has_its_test() {
    let mut files = BTreeSet::new();
    for family in fs::read_dir(directory("scenarios")).unwrap() {
        let family = family.unwrap();
        for file in fs::read_dir(family.path()).unwrap() {
            let (family, file) = (family.file_name(), file.unwrap().path());
            assert_eq!(file.extension().unwrap(), "toml", "{}", file.display());
            let stem = file.file_stem().unwrap().display();
            files.insert(format!("{}/{stem}", family.display()));
        }
    }
    assert_eq!(files, FILES.iter().map(|file| (*file).to_owned()).collect());
}

/// Scenarios of the board that this build is for, if it is another than the reference; theirs are in tests/boards.
#[test]
#[ignore = "`cargo xtask test --only other-board` builds for that board"]
fn of_another_board() {
    let folder = directory("boards").join(board::NAME);
    let files = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let stem = |file: fs::DirEntry| file.path().file_stem()?.to_str().map(str::to_owned);
    let mut files: Vec<_> = files.filter_map(|file| stem(file.unwrap())).collect();
    files.sort();
    let files: Vec<_> = files.iter().map(String::as_str).collect();
    all_variants("boards", board::NAME, &files);
}

#[test]
fn scenarios_of_other_boards_are_of_a_board_and_can_be_read() {
    for folder in fs::read_dir(directory("boards")).unwrap() {
        let folder = folder.unwrap();
        let name = folder.file_name().into_string().unwrap();
        let board = directory("../boards").join(&name).with_extension("toml");
        assert!(board.is_file(), "{}", board.display());
        let files: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
        assert!(!files.is_empty(), "{name}");
        for file in files {
            let stem = file.unwrap().path().with_extension("");
            read(stem.to_str().unwrap());
        }
    }
}
