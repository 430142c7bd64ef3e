//! What the half-bridge does, and what may follow on what.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Open | start, off, any fault, replay | power is asked for and the tank is at rest: LowerOn |
//! | LowerOn | power asked for | first zero crossing after 1 ms: Switching |
//! | Switching | LowerOn | off, fault, replay: Open at once |
//!
//! Off, fault and replay lead from LowerOn to Open as well. The tank is at rest from the first zero
//! crossing after the switches opened: until then the resonance capacitor follows the mains through a
//! diode, and a switch that closed would short what it holds.

use crate::limits::BOOTSTRAP_CHARGE_NS;
use crate::pwm;

/// The two switches of the half-bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bridge {
    /// Both open.
    Open,
    /// The lower one closed: it charges the upper driver's bootstrap capacitor.
    LowerOn,
    /// In turn, with dead time.
    Switching,
}

/// What the board does with the half-bridge, from the next block on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    /// Switching frequency, in hertz; the ADC trigger follows it whatever the bridge does.
    pub f_sw_hz: u32,
    /// The switches.
    pub bridge: Bridge,
}

impl Drive {
    /// Both switches open, sampling at the highest rate.
    pub const OFF: Self = Self {
        f_sw_hz: pwm::HIGHEST_HZ,
        bridge: Bridge::Open,
    };

    /// Heating at a frequency in hertz.
    pub const fn switching(f_sw_hz: u32) -> Self {
        Self {
            f_sw_hz,
            bridge: Bridge::Switching,
        }
    }

    /// Whether power flows.
    pub fn is_switching(self) -> bool {
        self.bridge == Bridge::Switching
    }

    /// What follows on this drive after a block, `wanted` being asked for: what opens both switches
    /// does so at once; out of open switches the lower one closes, once the tank is `at_rest`; what
    /// switches begins or changes at a zero crossing. `lower_on_ns` says for how long only the lower one
    /// is closed.
    pub fn next(self, wanted: Self, at_crossing: bool, lower_on_ns: u32, at_rest: bool) -> Self {
        match (self.bridge, wanted.bridge) {
            (Bridge::Open, Bridge::Switching) if !at_rest => self,
            (Bridge::Open, Bridge::Switching) => Self {
                bridge: Bridge::LowerOn,
                ..self
            },
            (Bridge::LowerOn, Bridge::Switching)
                if !at_crossing || lower_on_ns < BOOTSTRAP_CHARGE_NS =>
            {
                self
            }
            (Bridge::Switching, Bridge::Switching) if !at_crossing => self,
            _ => wanted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::realtime::{Block, RealTime};
    use ihd_shared::fault::Fault;
    use ihd_shared::sampling::{ADC_LOCK_P, Pair};
    use ihd_shared::units::{MicroOhm, PicoHenry};
    use std::boxed::Box;
    use std::vec::Vec;

    /// 37.5 µs at 80 kHz: blocks of a half-cycle of 50 Hz.
    const HALF_CYCLE: u32 = 266;

    struct Board {
        realtime: Box<RealTime>,
        block: u32,
    }

    impl Board {
        fn new() -> Self {
            let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
            Self {
                realtime: Box::new(RealTime::new(r, l)),
                block: 0,
            }
        }

        /// The bridge after each of so many blocks.
        fn run(&mut self, blocks: u32) -> Vec<Bridge> {
            (0..blocks)
                .map(|_| {
                    self.block += 1;
                    let crossing = self.block.is_multiple_of(HALF_CYCLE);
                    // No two blocks are alike, or they would be frozen.
                    let i = (self.block % 7) as i16;
                    let block = Block {
                        pairs: &core::array::from_fn::<_, ADC_LOCK_P, _>(|k| Pair {
                            v: 0,
                            i: if k == 0 { i } else { 0 },
                        }),
                        zero_crossing: crossing.then_some(0),
                        bus_dv: 300,
                        dc_link_ma: None,
                        lost: 0,
                    };
                    self.realtime.on_block(&block).bridge
                })
                .collect()
        }

        fn heat(&mut self) {
            self.realtime.request(Drive::switching(60_000));
        }
    }

    /// Whenever power is asked for, the lower switch is closed for a millisecond before the upper
    /// one may be, and switching begins at a zero crossing.
    #[test]
    fn the_bootstrap_capacitor_is_charged_before_the_bridge_switches() {
        for asked_at in [1, 30, HALF_CYCLE - 60, HALF_CYCLE - 28, HALF_CYCLE - 20] {
            let mut board = Board::new();
            assert!(board.run(asked_at).iter().all(|b| *b == Bridge::Open));
            board.heat();
            let seen = board.run(2 * HALF_CYCLE);
            let lower_on = seen.iter().take_while(|b| **b == Bridge::LowerOn).count() as u32;
            assert!(
                seen[lower_on as usize..]
                    .iter()
                    .all(|b| *b == Bridge::Switching)
            );
            // The first block's answer counts from the next one.
            assert!(lower_on * 37_500 >= BOOTSTRAP_CHARGE_NS, "{lower_on}");
            assert!(lower_on <= HALF_CYCLE + 27, "{lower_on}");
            assert_eq!((asked_at + lower_on + 1) % HALF_CYCLE, 0);
        }
    }

    #[test]
    fn off_and_faults_open_both_switches_at_once_from_any_state() {
        for blocks in [5, 2 * HALF_CYCLE] {
            let mut board = Board::new();
            board.heat();
            assert_ne!(board.run(blocks).pop(), Some(Bridge::Open));
            board.realtime.request(Drive::OFF);
            assert_eq!(board.run(1), [Bridge::Open]);

            let mut board = Board::new();
            board.heat();
            board.run(blocks);
            board.realtime.raise(Fault::HARDWARE_OVER_CURRENT);
            assert_eq!(board.run(3), [Bridge::Open; 3]);
            // Cleared, it stays open until power is asked for; then it charges again, once the mains has
            // passed its zero if it switched.
            board.realtime.clear_fault();
            assert_eq!(board.run(3), [Bridge::Open; 3]);
            board.heat();
            let switched = blocks > HALF_CYCLE;
            let to_crossing = if switched {
                HALF_CYCLE - board.block % HALF_CYCLE
            } else {
                1
            };
            let waited = board.run(to_crossing);
            let (last, before) = waited.split_last().expect("at least one");
            assert!(before.iter().all(|b| *b == Bridge::Open));
            assert_eq!(*last, Bridge::LowerOn);
        }
    }
}
