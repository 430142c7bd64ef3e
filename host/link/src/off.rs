//! Switching off before everything else that is asked of a device.
//!
//! A command that waits for its answer looks around: where somebody waits to switch off, the device is told at once, and the command is
//! given up unless its answer comes within a moment. Then it is switched off as by any command, with an answer.

use std::time::Duration;

use super::{Client, LinkError};

/// How often a command that waits for its answer looks around, on the transport's clock.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Way in which commands give way to switching off.
#[derive(Default)]
pub(super) struct GivingWay {
    /// Returns `true` while somebody waits to switch off.
    waits: Option<Box<dyn Fn() -> bool + Send>>,
    /// It is what is under way.
    is_off: bool,
    /// The device was told during the command under way.
    pub(super) is_told: bool,
}

impl GivingWay {
    /// Returns `true` if somebody waits to switch off while something else is under way.
    pub(super) fn is_wanted(&self) -> bool {
        !self.is_off && self.waits.as_ref().is_some_and(|waits| waits())
    }

    /// How long a command may wait without looking around.
    pub(super) fn look_every(&self) -> Duration {
        match self.waits {
            Some(_) => LOOK_EVERY,
            None => Duration::MAX,
        }
    }
}

impl Client {
    /// Lets commands that wait for their answer give way while `waits` returns `true`: they end with [`LinkError::GaveWay`].
    #[cfg(feature = "async")]
    pub(crate) fn give_way_to_off(&mut self, waits: impl Fn() -> bool + Send + 'static) {
        self.giving_way().waits = Some(Box::new(waits));
    }

    /// Switches off; it gives way to nothing.
    ///
    /// # Errors
    /// As every command.
    pub fn off(&mut self) -> Result<(), LinkError> {
        self.giving_way().is_off = true;
        let off = self.set_power(0);
        self.giving_way().is_off = false;
        off
    }
}
