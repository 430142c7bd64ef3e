//! Any file that a scope or program might have written, by the reader of the format that it begins like.

#![cfg_attr(fuzzing, no_main)]

use ihd_capture::format::open_bytes;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some(Ok(mut source)) = open_bytes(bytes.to_vec()) else {
        return;
    };
    // A table may hold nothing beside its time.
    let Some(second) = source.channels().len().min(2).checked_sub(1) else {
        return;
    };
    // Columns of one length; samples that are not finite are the survey's to cut.
    if let Ok(samples) = source.read(&[0, second], &mut |_| ()) {
        let length = samples.columns[0].len();
        for column in &samples.columns {
            assert_eq!(column.len(), length);
        }
    }
});
