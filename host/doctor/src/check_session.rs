//! Session of checks with a device that may be of another version, refuse requests, send wrong data, or disconnect.

use ihd_link::{Client, LinkError};
use ihd_shared::wire::messages::Outcome;

use crate::Check;

/// Missing answers after which the link counts as lost; each costs its time-out.
const MAX_MISSING_ANSWERS: u32 = 2;

/// Checks of one device, until its link is lost.
pub(crate) struct CheckSession<'a> {
    client: &'a mut Client,
    /// Reason for skipping the remaining checks; `None` while the session continues.
    lost: Option<String>,
    silences: u32,
    checks: Vec<Check>,
}

impl<'a> CheckSession<'a> {
    /// Creates a session without checks.
    pub(crate) fn new(client: &'a mut Client) -> Self {
        Self {
            client,
            lost: None,
            silences: 0,
            checks: Vec::new(),
        }
    }

    /// Makes the request that check `name` needs; if there is no answer, adds the check with that result.
    pub(crate) fn check_answer<T>(
        &mut self,
        name: &'static str,
        question: impl FnOnce(&mut Client) -> Result<T, LinkError>,
    ) -> Option<T> {
        if let Some(lost) = &self.lost {
            self.checks.push(Check::not_tested(name, lost));
            return None;
        }
        let error = match question(self.client) {
            Ok(answer) => return Some(answer),
            Err(error) => error,
        };
        let check = match &error {
            LinkError::Refused {
                outcome: Outcome::UnknownMessage,
                ..
            } => Check::not_tested(name, error.to_string()).with_remedy("ihd flash"),
            LinkError::Refused {
                outcome: Outcome::Unavailable,
                ..
            } => Check::not_tested(
                name,
                "the device has nothing to test there: it is simulated",
            ),
            LinkError::Refused {
                outcome: Outcome::NotIdle,
                ..
            } => Check::not_tested(name, error.to_string())
                .with_remedy("Switch it off: ihd device DEV off; then again"),
            LinkError::NoAnswer { .. } => {
                self.silences += 1;
                if self.silences >= MAX_MISSING_ANSWERS {
                    self.lost = Some(format!("it answers no more: {error}"));
                }
                Check::fail(
                    name,
                    error.to_string(),
                    "ihd log shows what it does; press NRST",
                )
            }
            LinkError::Refused { .. } => {
                Check::fail(name, error.to_string(), "Again; then report it")
            }
            _ => {
                self.lost = Some(format!("the link was lost: {error}"));
                Check::not_tested(name, error.to_string())
            }
        };
        self.checks.push(check);
        None
    }

    /// Makes a check even if the session has been ended.
    pub(crate) fn check_always(&mut self, check: impl FnOnce(&mut Client) -> Check) {
        let check = check(self.client);
        self.checks.push(check);
    }

    /// Adds a check.
    pub(crate) fn add(&mut self, check: Check) {
        self.checks.push(check);
    }

    /// Ends the session; the remaining checks are not tested for this reason.
    pub(crate) fn skip_rest(&mut self, why: impl Into<String>) {
        self.lost.get_or_insert(why.into());
    }

    /// Returns the checks, and the reason for skipping the rest if there was one.
    pub(crate) fn finish(self) -> (Vec<Check>, Option<String>) {
        (self.checks, self.lost)
    }
}
