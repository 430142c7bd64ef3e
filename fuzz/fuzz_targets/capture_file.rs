//! The reader of capture files on arbitrary bytes: an error or a capture, in bounded memory.

#![cfg_attr(fuzzing, no_main)]

use ihd_capture::mcap;
use ihd_capture::mcap::SessionReader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    // The reader seeks in a file; shared memory keeps that fast.
    let name = format!("ihd-fuzz-{}.mcap", std::process::id());
    let shared = std::path::Path::new("/dev/shm");
    let path = if shared.is_dir() {
        shared.join(name)
    } else {
        std::env::temp_dir().join(name)
    };
    std::fs::write(&path, bytes).expect("room for one input");
    // As the program reads it, past damage; and up to the first damage.
    let _ = mcap::salvage(&path);
    let _ = mcap::read(&path);
    if let Ok(mut session) = SessionReader::open(&path) {
        while let Ok(Some(_)) = session.next_event() {}
    }
});
