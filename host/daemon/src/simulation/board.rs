//! Hob that runs the firmware on the simulated board of `ihd hob`, stepped by the world's clock.

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::State;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::injection::{Injection, InjectionKind};

use super::hob::WorldHob;

/// Largest lead over the world's time after a request.
const LEAD: Duration = Duration::from_millis(10);

/// Number of steps of a trip: a few more than the lost blocks.
const TRIP_BLOCKS: u32 = 10;

/// Simulated board.
pub struct SimulatedBoard {
    boot_id: u32,
    sim: SimHob,
    /// World's time at which it was switched on.
    began: Duration,
    /// Sent bytes of an incomplete frame.
    outgoing: Vec<u8>,
}

impl SimulatedBoard {
    /// Creates a board that is switched on at the world's time `now`.
    pub fn new(boot_id: u32, now: Duration) -> Self {
        let config = HobConfig {
            boot: Some(boot_id),
            seed: boot_id.into(),
            ..HobConfig::default()
        };
        Self {
            boot_id,
            sim: SimHob::new(&config),
            began: now,
            outgoing: Vec::new(),
        }
    }
}

impl WorldHob for SimulatedBoard {
    fn asked_w(&self) -> u16 {
        self.sim.housekeeping().control().asked_w()
    }

    fn lookup(&self) -> &RlLookup {
        self.sim.housekeeping().lookup()
    }

    fn advance_to(&mut self, now: Duration) {
        let until_s = now.saturating_sub(self.began).as_secs_f64();
        while self.sim.t_s() < until_s {
            self.sim.step();
        }
    }

    fn receive(&mut self, frame: &[u8]) {
        self.sim.send(frame);
        while self.sim.unread() > 0 {
            self.sim.step();
        }
    }

    fn take_sent(&mut self, now: Duration) -> Option<Vec<u8>> {
        // Frames sent later than `now`, on a connection that was cut, are not there yet.
        if self.sim.t_s() > (now.saturating_sub(self.began) + LEAD).as_secs_f64() {
            return None;
        }
        let mut byte = [0];
        while self.sim.receive(&mut byte) > 0 {
            self.outgoing.push(byte[0]);
            if byte == [0] && self.outgoing.len() > 1 {
                return Some(std::mem::take(&mut self.outgoing));
            }
        }
        None
    }

    fn discard_sent(&mut self) {
        self.outgoing.clear();
        let mut bytes = [0; 1024];
        while self.sim.receive(&mut bytes) > 0 {}
    }

    /// Restarts with the built-in lookup, because the flash is not simulated.
    fn reboot(&mut self, now: Duration) {
        *self = Self::new(self.boot_id + 1, now);
    }

    fn trip(&mut self) {
        let kind = InjectionKind::LostBlocks;
        let injection = Injection {
            kind,
            value: 1.0,
            channel: kind.default_channel(),
        };
        let mut number = 0;
        self.sim.inject(|all| number = all.start(injection));
        for _ in 0..TRIP_BLOCKS {
            self.sim.step();
        }
        self.sim.inject(|all| all.end(number));
    }

    fn is_locked_out(&self) -> bool {
        self.sim.housekeeping().control().state() == State::LockedOut
    }
}
