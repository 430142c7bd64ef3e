//! End of computations at ^C.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::time::{Duration, Instant};

use pyo3::prelude::*;

/// Period at which computations look for a signal: at ^C nobody notices a tenth of a second.
const PERIOD: Duration = Duration::from_millis(100);

/// Runs `work` without the interpreter's lock. The function that it gets, and calls as it goes on, looks for a signal; ^C unwinds
/// from there, as the rooms of the host report their progress but cannot be stopped.
///
/// # Errors
/// Exception of the signal's handler: `KeyboardInterrupt`.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&mut dyn FnMut()) -> T + Send,
) -> PyResult<T> {
    let ended = py.detach(|| {
        let mut last = Instant::now();
        let mut look = || {
            if last.elapsed() < PERIOD {
                return;
            }
            last = Instant::now();
            if let Err(raised) = Python::attach(|py| py.check_signals()) {
                resume_unwind(Box::new(raised));
            }
        };
        catch_unwind(AssertUnwindSafe(|| work(&mut look)))
    });
    ended.or_else(|thrown| match thrown.downcast::<PyErr>() {
        Ok(raised) => Err(*raised),
        Err(panic) => resume_unwind(panic),
    })
}
