//! ^C as a flag, so that a command ends in order: hob off, files complete.

use std::sync::atomic::{AtomicBool, Ordering};

static STOP: AtomicBool = AtomicBool::new(false);

/// A flag that ^C or a termination signal raises. A second ^C ends the process at once.
///
/// # Errors
/// When the handler cannot be installed.
pub fn flag() -> Result<&'static AtomicBool, ctrlc::Error> {
    ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })?;
    Ok(&STOP)
}
