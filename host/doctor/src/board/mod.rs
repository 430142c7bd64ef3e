//! The board's self-test with the bridge off.

mod electrical;
mod link;
mod start;

pub(crate) use electrical::{OFFSET_CODES, bus_volt};

use ihd_link::{BoardFacts, Client};
use ihd_shared::wire::messages::{State, Status};

use crate::Check;
use crate::asking::Asking;

/// What is asked of every board, in this order; each check is there whatever comes of it.
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

/// Why a device that heats is asked nothing.
pub const HEATS: &str = "it heats";

/// What a board said.
#[derive(Debug)]
pub struct Examined {
    /// The checks, all of [`NAMES`].
    pub checks: Vec<Check>,
    /// What the device says of itself, or why not.
    pub facts: Result<BoardFacts, String>,
    /// Why it ended before its end.
    pub lost: Option<String>,
}

/// Whether a device is off, and stays so by itself.
pub(crate) fn is_off(status: &Status) -> bool {
    status.asked_w == 0 && !matches!(status.state, State::Probing | State::Heating)
}

/// Examines a board whose bridge is off. While it heats nothing is asked of it.
pub fn examine(client: &mut Client) -> Examined {
    let hello = client.hello().clone();
    let scales = client.front_end().clone();
    let mut asking = Asking::of(client);
    let status = asking.ask("idle", Client::status);
    match &status {
        Some(status) if !is_off(status) => {
            asking.add(Check::fail(
                "idle",
                format!("it is {:?}, asked for {} W", status.state, status.asked_w),
                "Nothing is tested while it heats. Switch it off: ihd device DEV off",
            ));
            asking.stop(HEATS);
        }
        Some(status) => asking.add(Check::pass(
            "idle",
            format!("{:?}, no power asked for", status.state),
        )),
        None => {}
    }
    // What needs no further answer is not lost with the link.
    asking.add(start::reset_cause(&hello));
    match &status {
        Some(status) => asking.add(start::fault(status)),
        None => asking.add(Check::not_tested("fault", "the device did not tell")),
    }
    let facts = asking.ask("chip", Client::board);
    match &facts {
        Some(facts) => {
            asking.add(start::chip(facts));
            asking.add(start::option_bytes(facts));
            asking.add(start::flash_crc(facts));
        }
        None => {
            for name in ["option_bytes", "flash_crc"] {
                asking.add(Check::not_tested(name, "the device did not tell"));
            }
        }
    }
    if let Some(clocks) = asking.ask("clocks", Client::clocks) {
        asking.add(electrical::clocks(&clocks));
    }
    match asking.ask("channels", Client::channels) {
        Some(found) => {
            asking.add(electrical::offsets(&found, &scales));
            asking.add(electrical::noise(&found));
            asking.add(electrical::supply(&found));
        }
        None => {
            for name in ["noise", "supply"] {
                asking.add(Check::not_tested(name, "the channels were not looked at"));
            }
        }
    }
    if let Some(found) = asking.ask("comparators", Client::comparators) {
        asking.add(electrical::comparators(&found));
    }
    match &status {
        Some(status) => asking.add(electrical::temperatures(status)),
        None => asking.add(Check::not_tested("temperatures", "the device did not tell")),
    }
    if let Some(used) = asking.ask("processor", Client::utilisation) {
        asking.add(link::processor(&used));
    }
    if let Some(waits) = asking.ask("latency", link::waits) {
        asking.add(link::latency(waits));
    }
    match asking.ask("link_to_device", link::test) {
        Some(test) => {
            asking.add(link::to_device(&test));
            asking.add(link::from_device(&test));
        }
        None => asking.add(Check::not_tested(
            "link_from_device",
            "the link was not tested",
        )),
    }
    let (checks, lost) = asking.end();
    let facts = facts.ok_or_else(|| {
        let chip = checks.iter().find(|check| check.name == "chip");
        chip.map_or_else(
            || "the device did not tell".to_owned(),
            |c| c.finding.clone(),
        )
    });
    Examined {
        checks,
        facts,
        lost,
    }
}
