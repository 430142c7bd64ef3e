#![cfg_attr(fuzzing, no_main)]

mod drain;

use std::io::Cursor;

use ihd_capture::formats::input::Input;
use ihd_capture::formats::mat;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    drain::drain(Input::new(Cursor::new(bytes.to_vec())).and_then(mat::open));
});
