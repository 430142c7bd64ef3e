//! Self-test of a board with the bridge open.

mod electrical;
mod link;
mod start;

pub(crate) use electrical::{OFFSET_CODES, bus_volt};

use ihd_link::{BoardFacts, Client};
use ihd_shared::wire::messages::{State, Status};

use crate::Check;
use crate::check_session::CheckSession;

/// Checks of a board, in this order; each is in the report in any case.
pub const NAMES: [&str; 16] = [
    "idle",
    "reset_cause",
    "fault",
    "chip",
    "option_bytes",
    "flash_crc",
    "clocks",
    "channels",
    "noise",
    "supply",
    "comparators",
    "temperatures",
    "processor",
    "latency",
    "link_to_device",
    "link_from_device",
];

/// Reason for not examining a device that heats.
pub const HEATS: &str = "it heats";

/// Result of an examination.
#[derive(Debug)]
pub struct BoardExamination {
    /// Checks, one for each of [`NAMES`].
    pub checks: Vec<Check>,
    /// Identity reported by the device, or the reason why there is none.
    pub facts: Result<BoardFacts, String>,
    /// Reason for the early end; `None` if it is complete.
    pub lost: Option<String>,
}

/// Returns `true` if a device is off and does not switch on by itself.
pub(crate) fn is_off(status: &Status) -> bool {
    status.asked_w == 0 && !matches!(status.state, State::Probing | State::Heating)
}

/// Examines a board whose bridge is open. A board that heats is not examined.
pub fn examine(client: &mut Client) -> BoardExamination {
    let hello = client.hello().clone();
    let scales = client.front_end().clone();
    let mut session = CheckSession::new(client);
    let status = session.check_answer("idle", Client::status);
    match &status {
        Some(status) if !is_off(status) => {
            session.add(Check::fail(
                "idle",
                format!("it is {:?}, asked for {} W", status.state, status.asked_w),
                "Nothing is tested while it heats. Switch it off: ihd device DEV off",
            ));
            session.skip_rest(HEATS);
        }
        Some(status) => session.add(Check::pass(
            "idle",
            format!("{:?}, no power asked for", status.state),
        )),
        None => {}
    }
    let facts = start::examine(&mut session, &hello, status.as_ref());
    electrical::examine(&mut session, &scales);
    link::examine(&mut session);
    let (checks, lost) = session.finish();
    let facts = facts.ok_or_else(|| {
        let chip = checks.iter().find(|check| check.name == "chip");
        chip.map_or_else(
            || "the device did not report it".to_owned(),
            |c| c.finding.clone(),
        )
    });
    BoardExamination {
        checks,
        facts,
        lost,
    }
}
