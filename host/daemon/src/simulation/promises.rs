//! Record of what the promises of the daemon are checked against.

use std::collections::BTreeSet;
use std::time::Duration;

use super::hob::HOBS;

/// Longest time for which the daemon may report a power that the hob does not have: the period of comparison, two time-outs of the link,
/// and the longest wait between two attempts to connect.
const MISREPORT_LIMIT: Duration = Duration::from_secs(20);

/// The same limit if no fault occurs but a foreign hello: KEEPALIVE_PERIOD, and a tick.
const MISREPORT_LIMIT_CALM: Duration = Duration::from_millis(2_500);

/// Record of what the promises are checked against.
#[derive(Default)]
pub struct Promises {
    /// First broken promise.
    pub broken: Option<String>,
    /// Windows that the daemon has reported as stored: hob, boot, number.
    pub stored: BTreeSet<(usize, u32, u32)>,
    /// Results that the daemon has reported as stored: hob, boot, number.
    pub results: BTreeSet<(usize, u32, u32)>,
    /// Number of the last user request, in order of time.
    requests: u64,
    pub(super) hobs: [HobRecord; HOBS.len()],
}

/// Record of one hob.
#[derive(Default)]
pub(super) struct HobRecord {
    /// Number of the last request that may heat.
    pub(super) last_heating: u64,
    /// Number of the last acknowledged `off`.
    pub(super) off: Option<u64>,
    /// Time since which power is requested without a valid lease.
    pub(super) unheld_since: Option<Duration>,
    /// Time since which the daemon has reported a power that the hob does not have.
    misreport_since: Option<Duration>,
}

impl HobRecord {
    /// Returns an error text if the daemon has reported a wrong power, `reported_w`, for too long.
    pub(super) fn check_report(
        &mut self,
        reported_w: u16,
        asked_w: u16,
        now: Duration,
        is_calm: bool,
    ) -> Option<String> {
        if reported_w == 0 || reported_w == asked_w {
            self.misreport_since = None;
            return None;
        }
        let since = *self.misreport_since.get_or_insert(now);
        let bound = match is_calm {
            true => MISREPORT_LIMIT_CALM,
            false => MISREPORT_LIMIT,
        };
        (now - since > bound).then(|| {
            let since_s = since.as_secs_f64();
            format!("the daemon reports {reported_w} W since {since_s:.3} s, and the hob has {asked_w} W")
        })
    }
}

impl Promises {
    pub(super) fn note_broken(&mut self, why: String) {
        self.broken.get_or_insert(why);
    }

    pub(super) fn next_request(&mut self) -> u64 {
        self.requests += 1;
        self.requests
    }
}
