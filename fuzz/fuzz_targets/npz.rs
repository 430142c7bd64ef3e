#![cfg_attr(fuzzing, no_main)]

mod drain;

use std::io::Cursor;

use ihd_capture::formats::npz;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    drain::drain(npz::open(Cursor::new(bytes.to_vec())));
});
