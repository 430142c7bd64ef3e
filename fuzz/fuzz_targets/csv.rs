#![cfg_attr(fuzzing, no_main)]

mod drain;

use std::io::Cursor;

use ihd_capture::formats::csv::CsvSource;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    drain::drain(CsvSource::open(Cursor::new(bytes.to_vec()), None));
});
