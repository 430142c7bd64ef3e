//! Stands in for libfuzzer-sys where a fuzz target is a module of a test.

/// Makes the target's body a function `fuzz(&[u8])` of its module.
#[macro_export]
macro_rules! fuzz_target {
    (|$bytes:ident: &[u8]| $body:expr) => {
        /// Tries one input; panics where what must hold does not.
        pub fn fuzz($bytes: &[u8]) {
            $body
        }
    };
}
