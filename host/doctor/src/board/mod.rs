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
    // Checks without a request do not depend on the link.
    session.add(start::reset_cause(&hello));
    match &status {
        Some(status) => session.add(start::fault(status)),
        None => session.add(Check::not_tested("fault", "the device did not report it")),
    }
    let facts = session.check_answer("chip", Client::board);
    match &facts {
        Some(facts) => {
            session.add(start::chip(facts));
            session.add(start::option_bytes(facts));
            session.add(start::flash_crc(facts));
        }
        None => {
            for name in ["option_bytes", "flash_crc"] {
                session.add(Check::not_tested(name, "the device did not report it"));
            }
        }
    }
    if let Some(clocks) = session.check_answer("clocks", Client::clocks) {
        session.add(electrical::clocks(&clocks));
    }
    match session.check_answer("channels", Client::channels) {
        Some(found) => {
            session.add(electrical::offsets(&found, &scales));
            session.add(electrical::noise(&found));
            session.add(electrical::supply(&found));
        }
        None => {
            for name in ["noise", "supply"] {
                session.add(Check::not_tested(name, "the channels were not measured"));
            }
        }
    }
    if let Some(found) = session.check_answer("comparators", Client::comparators) {
        session.add(electrical::comparators(&found));
    }
    match &status {
        Some(status) => session.add(electrical::temperatures(status)),
        None => session.add(Check::not_tested(
            "temperatures",
            "the device did not report it",
        )),
    }
    if let Some(used) = session.check_answer("processor", Client::utilisation) {
        session.add(link::processor(&used));
    }
    if let Some(waits) = session.check_answer("latency", link::answer_times) {
        session.add(link::latency(waits));
    }
    match session.check_answer("link_to_device", link::run_test) {
        Some(test) => {
            session.add(link::to_device(&test));
            session.add(link::from_device(&test));
        }
        None => session.add(Check::not_tested(
            "link_from_device",
            "the link was not tested",
        )),
    }
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
