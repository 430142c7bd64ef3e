//! Ctrl-C as a flag, so that a command ends in order: hob off, files complete.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::sleep;
use std::time::Duration;

static STOP: AtomicBool = AtomicBool::new(false);
static SIGNALS: AtomicU32 = AtomicU32::new(0);

/// Time limit for ending in order after a second Ctrl-C.
const IN_ORDER_WITHIN: Duration = Duration::from_secs(3);

/// Returns a flag that Ctrl-C or a termination signal raises. A second one leaves the command 3 s to switch the hob off, a third
/// ends the process at once.
///
/// # Errors
/// If the handler cannot be installed.
pub fn flag() -> Result<&'static AtomicBool, ctrlc::Error> {
    ctrlc::set_handler(|| {
        STOP.store(true, Ordering::Relaxed);
        match SIGNALS.fetch_add(1, Ordering::Relaxed) {
            0 => {}
            // The handler has a thread of its own, which must be free for a third one.
            1 => drop(std::thread::spawn(|| {
                sleep(IN_ORDER_WITHIN);
                std::process::exit(130);
            })),
            _ => std::process::exit(130),
        }
    })?;
    Ok(&STOP)
}

/// Lets Ctrl-C or a termination signal end the process with exit code 0, where nothing needs to be switched off.
///
/// # Errors
/// If the handler cannot be installed.
pub fn ends() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| std::process::exit(0))
}
