//! The board's watchdog: it resets a program whose blocks or housekeeping stand still, until that has ended too often.

use ihd_firmware::limits::WATCHDOG_US;
use ihd_firmware::retained::reset::{GOOD_START_BLOCKS, MAX_ENDS};
use ihd_firmware::self_test::heartbeat::Heartbeat;

const WATCHDOG_S: f64 = WATCHDOG_US as f64 * 1e-6;

/// Watchdog with its oscillator, and the count of ends that outlives its reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watchdog {
    heartbeat: Heartbeat,
    fed_s: f64,
    bites: u32,
    /// Ends in a row.
    ends: u32,
}

impl Watchdog {
    /// Takes the number of blocks since boot after each turn of housekeeping; returns `true` if it resets.
    pub(super) fn bites(&mut self, blocks: u32, t_s: f64) -> bool {
        if blocks >= GOOD_START_BLOCKS {
            self.ends = 0;
        }
        if self.heartbeat.beat(blocks) {
            self.fed_s = t_s;
        }
        let bites = t_s - self.fed_s > WATCHDOG_S;
        if bites {
            self.bites += 1;
            self.ends += 1;
        }
        bites
    }

    /// Begins its time anew at the start of a program.
    pub(super) fn start(&mut self, t_s: f64) {
        (self.heartbeat, self.fed_s) = (Heartbeat::default(), t_s);
    }

    /// Number of resets since power-on.
    pub(super) fn count(&self) -> u32 {
        self.bites
    }

    /// Returns `true` if the program stays stopped, with the outputs open, until power-on.
    pub(super) fn has_given_up(&self) -> bool {
        self.ends > MAX_ENDS
    }
}
