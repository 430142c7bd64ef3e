//! Errors that end a training run.

use ihd_capture::mcap::McapFileError;
use ihd_link::LinkError;
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::Pot;

use super::{OperatingPoint, RunReport};

/// Reason for which a training run ended early. The device keeps the last lookup that it accepted.
#[derive(Debug, thiserror::Error)]
pub enum TrainerError {
    /// The link failed, or the device refused a command.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The device is off until a person switches it off and on.
    #[error("fault {number} on the device at {point}: {text}", number = .fault.number(), text = .fault.text())]
    Fault {
        /// The fault.
        fault: Fault,
        /// Operating point.
        point: OperatingPoint,
    },
    /// The device waited for a pot, and gave up.
    #[error(
        "no pot that can be heated at {point}: the device looked for one until it gave up (pot: {pot:?}); put a \
         ferromagnetic one on and start again"
    )]
    NoPot {
        /// Last pot state.
        pot: Pot,
        /// Operating point.
        point: OperatingPoint,
    },
    /// The device was switched off at its panel or by another host.
    #[error("the device was switched off at {point}, at its panel or by another host")]
    SwitchedOff {
        /// Operating point.
        point: OperatingPoint,
    },
    /// The power did not settle.
    #[error(
        "{asked_w} W did not settle within {seconds} s of device time (last {last_w:.0} W at \
         {f_sw_hz} Hz): is it within what this load takes at this mains voltage?"
    )]
    NotSettled {
        /// Power that was asked for, in watt.
        asked_w: u16,
        /// Last power, in watt.
        last_w: f64,
        /// Last switching frequency, in hertz.
        f_sw_hz: u32,
        /// Time that it heated, in seconds.
        seconds: u64,
    },
    /// The device or its windows stopped coming.
    #[error("{what} did not come within {seconds} s of device time; windows: {windows}")]
    Silent {
        /// Expected message.
        what: &'static str,
        /// Time waited, in seconds.
        seconds: u64,
        /// Window counters, as text.
        windows: String,
    },
    /// Several windows in a row were not fit for the lookup.
    #[error("no window at {point} was fit for the lookup; the last one: {why}")]
    NoFit {
        /// Operating point.
        point: OperatingPoint,
        /// The gate's reason for the last one.
        why: String,
    },
    /// A device would not accept the lookup that follows from the windows.
    #[error("the identified lookup is not pushed: {0}")]
    Lookup(String),
    /// ^C, or a signal to end.
    #[error("interrupted")]
    Interrupted,
    /// The recording of the session could not be started.
    #[error(transparent)]
    Store(#[from] McapFileError),
    /// A file of the store could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: String,
        /// The operating system's error.
        source: std::io::Error,
    },
}

/// Failure of a run, with the report up to then.
#[derive(thiserror::Error)]
#[error("{error}{}", .left_on.as_ref().map_or(String::new(), |why| format!(
    "; the hob could not be switched off ({why}): it switches itself off 10 s after it has last heard from us"
)))]
pub struct RunFailure {
    /// Report up to the failure.
    pub report: RunReport,
    /// Reason of the failure.
    #[source]
    pub error: TrainerError,
    /// Reason for which the hob was not switched off; `None` if it was.
    pub left_on: Option<String>,
}

impl std::fmt::Debug for RunFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self} ({} points)", self.report.points.len())
    }
}
