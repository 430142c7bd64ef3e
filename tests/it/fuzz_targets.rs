//! Every fuzz target on its committed inputs and on changed ones: what coverage-guided fuzzing (`cargo xtask fuzz`, the full tier) has found
//! stays mended.

use std::fs;
use std::path::{Path, PathBuf};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[path = "../../fuzz/fuzz_targets/capture_file.rs"]
mod capture_file;
#[path = "../../fuzz/fuzz_targets/deframer.rs"]
mod deframer;
#[path = "../../fuzz/fuzz_targets/host_frames.rs"]
mod host_frames;
#[path = "../../fuzz/fuzz_targets/import.rs"]
mod import;
#[path = "../../fuzz/fuzz_targets/incoming.rs"]
mod incoming;
#[path = "../../fuzz/fuzz_targets/log_frames.rs"]
mod log_frames;
#[path = "../../fuzz/fuzz_targets/lookup_and_hello.rs"]
mod lookup_and_hello;
#[path = "../../fuzz/fuzz_targets/pot_map.rs"]
mod pot_map;
#[path = "../../fuzz/fuzz_targets/survey.rs"]
mod survey;

/// Changed inputs for each committed one.
const CHANGED: usize = 2;

/// Longest input in bytes, as libFuzzer has it (xtask/src/fuzz.rs).
const MAX_INPUT_BYTES: usize = 16_384;

/// Files of the target's corpus, and of the folders that fuzz/Cargo.toml names for it.
fn seeds(target: &str) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let manifest = fs::read_to_string(root.join("fuzz/Cargo.toml")).unwrap();
    let named = manifest
        .lines()
        .filter(|line| line.starts_with(&format!("{target} = [")));
    let named = named.flat_map(|line| line.split('"').skip(1).step_by(2));
    let folders = named
        .map(PathBuf::from)
        .chain([Path::new("fuzz/corpus").join(target)]);
    let mut files: Vec<_> = folders
        .filter_map(|folder| fs::read_dir(root.join(folder)).ok())
        .flat_map(|entries| entries.map(|entry| entry.unwrap().path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    let read = files.iter().map(|path| fs::read(path).unwrap());
    read.filter(|bytes| bytes.len() <= MAX_INPUT_BYTES)
        .collect()
}

/// One of the changes that libFuzzer makes: bits, bytes, lengths, a piece twice or gone.
fn change(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    for _ in 0..rng.random_range(1..=4) {
        let at = rng.random_range(0..=bytes.len());
        let length = rng.random_range(0..=16).min(bytes.len() - at);
        match rng.random_range(0..5) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..at + length)),
            2 => bytes.extend_from_within(at..at + length),
            3 => bytes.insert(at, [0, 1, 0x7f, 0x80, 0xff][rng.random_range(0..5)]),
            _ if at < bytes.len() => bytes[at] ^= 1 << rng.random_range(0..8),
            _ => {}
        }
    }
    bytes.truncate(MAX_INPUT_BYTES);
}

fn run(target: &str, fuzz: fn(&[u8])) {
    let seeds = seeds(target);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    fuzz(&[]);
    for seed in &seeds {
        fuzz(seed);
        for _ in 0..CHANGED {
            let mut bytes = seed.clone();
            change(&mut bytes, &mut rng);
            fuzz(&bytes);
        }
    }
    // Targets without a corpus, and lengths that no seed has.
    for length in (0..16).map(|k| 64 * k) {
        let mut bytes = vec![0; length];
        rng.fill_bytes(&mut bytes);
        fuzz(&bytes);
    }
}

macro_rules! targets {
    ($($target:ident,)*) => {
        mod all {
            $(#[test]
            fn $target() {
                super::run(stringify!($target), super::$target::fuzz);
            })*

            #[test]
            fn are_those_of_the_folder() {
                let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/fuzz_targets");
                let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
                let files = files.filter(|path| path.extension().is_some_and(|end| end == "rs"));
                assert_eq!(files.count(), [$(stringify!($target)),*].len());
            }
        }
    };
}

targets! {
    capture_file,
    deframer,
    host_frames,
    import,
    incoming,
    log_frames,
    lookup_and_hello,
    pot_map,
    survey,
}
