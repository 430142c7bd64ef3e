//! Asking a device that may be of another version, may refuse, may lie, and may be gone.

use ihd_link::{Client, LinkError};
use ihd_shared::wire::messages::Outcome;

use crate::Check;

/// Answers that may stay away before the link counts as lost: each costs its time-out.
const SILENCES: u32 = 2;

/// Checks of one device, until its link is lost.
pub(crate) struct Asking<'a> {
    client: &'a mut Client,
    /// Why nothing more is asked.
    lost: Option<String>,
    silences: u32,
    checks: Vec<Check>,
}

impl<'a> Asking<'a> {
    /// Of a device.
    pub(crate) fn of(client: &'a mut Client) -> Self {
        Self {
            client,
            lost: None,
            silences: 0,
            checks: Vec::new(),
        }
    }

    /// Asks for what the check `name` rests on; where nothing comes, that is the check.
    pub(crate) fn ask<T>(
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
                if self.silences >= SILENCES {
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

    /// A check that is made whatever was lost before.
    pub(crate) fn always(&mut self, check: impl FnOnce(&mut Client) -> Check) {
        let check = check(self.client);
        self.checks.push(check);
    }

    /// Adds a check.
    pub(crate) fn add(&mut self, check: Check) {
        self.checks.push(check);
    }

    /// Asks nothing more; what would be asked is not tested, for this reason.
    pub(crate) fn stop(&mut self, why: impl Into<String>) {
        self.lost.get_or_insert(why.into());
    }

    /// The checks, and why they ended before their end.
    pub(crate) fn end(self) -> (Vec<Check>, Option<String>) {
        (self.checks, self.lost)
    }
}
