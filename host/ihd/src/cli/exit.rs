//! Exit codes: one row for each type of error that has its own.

use anyhow::Error;
use ihd_capture::CaptureError;
use ihd_link::LinkError;
use ihd_sim::server::HobServerError;
use ihd_survey::SurveyError;
use ihd_train::replay::ReplayError;

/// Reason of the end of a command, with its exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Any other failure.
    Failed = 1,
    /// Wrong usage, also reported by clap.
    Usage = 2,
    /// Device or link, or a daemon or server that does not answer.
    NoDevice = 3,
    /// The device does not heat.
    NoHeat = 4,
    /// No result that is fit for the lookup.
    NoFit = 5,
    /// A replay that differs.
    Differs = 6,
    /// A capture that is unfit for identification, empty, cut or damaged; limits that are missed; a damaged store.
    Unfit = 7,
}

/// Row of the table: the exit of an error, `None` if the row is for another type.
type Row = fn(&Error) -> Option<Exit>;

/// Types of errors with their exits; the first row that knows an error counts.
const TABLE: &[Row] = &[
    |e| {
        let is_usage = e.chain().any(|cause| cause.is::<super::usage::Usage>());
        is_usage.then_some(Exit::Usage)
    },
    #[cfg(feature = "pinn")]
    |e| match e.downcast_ref()? {
        ihd_pinn::PinnError::UnknownName { .. } => Some(Exit::Usage),
        _ => None,
    },
    #[cfg(feature = "pinn")]
    |e| e.downcast_ref().map(of_run),
    #[cfg(feature = "daemon")]
    |e| e.downcast_ref().map(of_config),
    #[cfg(feature = "daemon")]
    |e| match e.downcast_ref()? {
        ihd_api::ApiServerError::Reachable { .. } | ihd_api::ApiServerError::Nameless { .. } => {
            Some(Exit::Usage)
        }
        _ => None,
    },
    #[cfg(feature = "fleet")]
    |e| all::<ihd_fleet::AccessError>(e, Exit::NoDevice),
    #[cfg(feature = "fleet")]
    |e| all::<ihd_fleet::jetstream::JetStreamError>(e, Exit::NoDevice),
    #[cfg(feature = "daemon")]
    |e| all::<super::device::DoesNotHeat>(e, Exit::NoHeat),
    #[cfg(feature = "daemon")]
    |e| e.downcast_ref().map(of_command),
    #[cfg(feature = "daemon")]
    |e| e.downcast_ref().map(of_client),
    |e| match e.downcast_ref()? {
        super::doctor::ChecksFailed::Failed(_) => Some(Exit::Failed),
        super::doctor::ChecksFailed::NoDevice(_) => Some(Exit::NoDevice),
    },
    |e| all::<ihd_flash::install::InstallError>(e, Exit::NoDevice),
    |e| all::<ihd_flash::ProgramError>(e, Exit::NoDevice),
    |e| all::<ihd_flash::dfu::EnterError>(e, Exit::NoDevice),
    #[cfg(feature = "log")]
    |e| all::<ihd_flash::log::follow::LogError>(e, Exit::NoDevice),
    |e| all::<super::replay::ReplayDiffers>(e, Exit::Differs),
    |e| match e.downcast_ref()? {
        CaptureError::Empty { .. } | CaptureError::NoSamples { .. } => Some(Exit::Unfit),
        _ => None,
    },
    |e| all::<super::inspect::UnfitCapture>(e, Exit::Unfit),
    |e| all::<super::inspect::SingleChannel>(e, Exit::Unfit),
    |e| all::<super::identify::RefusedResults>(e, Exit::Unfit),
    |e| all::<super::simulate::scenario::MissedLimits>(e, Exit::Unfit),
    |e| all::<super::capture_args::IncompleteCapture>(e, Exit::Unfit),
    #[cfg(feature = "daemon")]
    |e| all::<super::store::DamagedStore>(e, Exit::Unfit),
    |e| match e.downcast_ref()? {
        SurveyError::Empty { .. } => Some(Exit::Unfit),
        _ => None,
    },
    |e| match e.downcast_ref()? {
        ReplayError::Link(_) | ReplayError::NotLocked { .. } => Some(Exit::NoDevice),
        _ => None,
    },
    |e| match e.downcast_ref()? {
        LinkError::Recording(_) => Some(Exit::Failed),
        _ => Some(Exit::NoDevice),
    },
    |e| all::<HobServerError>(e, Exit::NoDevice),
];

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Returns the exit of an error of a command.
pub fn exit_of(error: &Error) -> Exit {
    let exit = TABLE.iter().find_map(|row| row(error));
    exit.unwrap_or(Exit::Failed)
}

/// Prints the error of a program. Nothing where the reader of standard output went away, as `head` does.
pub fn complain(program: &str, error: &Error) {
    if !error.is::<super::output::OutputClosed>() {
        super::output::complain(format_args!("{program}: {}", super::message(error)));
    }
}

/// Returns `exit` for any error of type `E`.
fn all<E: std::error::Error + Send + Sync + 'static>(error: &Error, exit: Exit) -> Option<Exit> {
    error.is::<E>().then_some(exit)
}

#[cfg(feature = "pinn")]
fn of_run(failure: &ihd_train::RunFailure) -> Exit {
    use ihd_train::TrainerError as E;
    match &failure.error {
        E::Link(LinkError::Recording(_)) | E::Interrupted => Exit::Failed,
        E::Link(_) | E::Silent { .. } => Exit::NoDevice,
        E::Fault { .. } | E::NoPot { .. } | E::SwitchedOff { .. } => Exit::NoHeat,
        E::NotSettled { .. } | E::NoFit { .. } | E::Lookup(_) => Exit::NoFit,
        E::Store(_) | E::Write { .. } => Exit::Failed,
    }
}

#[cfg(feature = "daemon")]
fn of_config(error: &ihd_daemon::config::ConfigError) -> Exit {
    use ihd_daemon::config::ConfigError as E;
    match error {
        E::Read { .. } => Exit::Failed,
        E::Parse { .. } | E::Value { .. } => Exit::Usage,
    }
}

#[cfg(feature = "daemon")]
fn of_command(error: &ihd_model::CommandError) -> Exit {
    use ihd_model::CommandError as E;
    match error {
        E::NotConnected { .. } | E::Refused { .. } => Exit::NoDevice,
        E::NoDevice { .. } => Exit::Usage,
        E::Leased { .. } | E::Failed { .. } => Exit::Failed,
    }
}

#[cfg(feature = "daemon")]
fn of_client(error: &ihd_api::client::ClientError) -> Exit {
    use ihd_api::client::ClientError as E;
    match error {
        E::Command(error) => of_command(error),
        E::Unreachable { .. } | E::UnexpectedResponse { .. } => Exit::NoDevice,
        E::Refused { .. } | E::Certificate { .. } | E::Write { .. } => Exit::Failed,
    }
}
