//! Service: what a host asks of the controller besides heating. What the device is, tests of the board with the bridge
//! open, a test of the link, a new beginning.
//!
//! ```text
//! Housekeeping::receive ─► Service: one order at a time ─► Housekeeping::serve, after each block
//!                                                          │ asks the board's [`Facilities`]
//!                              transmit queue ◄── answer ──┘
//! ```

use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::link_test::Received;
use ihd_shared::wire::messages::{
    Clocks, Comparators, LinkData, Outcome, Program, Reply, State, TestLink,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::RESTART_AFTER_MS;

use crate::channels::{Measuring, Reference, SlowCodes};
use crate::drive::Bridge;
use crate::housekeeping::{Housekeeping, outcome};
use crate::log_ring::LogSource;
use crate::realtime::Access;
use crate::transmit_queue::Answer;

/// Longest count of the clocks before the test is given up, in milliseconds.
const CLOCKS_WITHIN_MS: u32 = 900;

/// Identity of the device, as far as its chip and its program know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// DBGMCU_IDCODE; 0 where there is no chip.
    pub id_code: u32,
    /// Flash, in KiB.
    pub flash_kib: u16,
    /// FLASH_OPTR.
    pub option_bytes: u32,
    /// RCC_CSR as the program found it.
    pub reset_flags: u32,
    /// Starts since power came on, this one included; 255 for that many or more.
    pub starts: u8,
    /// Bytes of the program in flash before its CRC.
    pub image_bytes: u32,
    /// Their CRC-32 as worked out at start.
    pub image_crc: u32,
    /// The CRC-32 that the program was sealed with.
    pub sealed_crc: u32,
    /// GNU build id.
    pub build_id: Option<[u8; 20]>,
    /// The chip's unique number.
    pub chip: Option<[u8; 12]>,
}

/// Abilities of the board alone. A board without one of these leaves it as it stands here; it is not asked again for that
/// order.
pub trait Facilities {
    /// Returns `true` if [`Facilities::restart`] leads there.
    fn has_program(&self, _into: Program) -> bool {
        false
    }
    /// Ends the program, outputs open, for `into`. A board does not come back; a simulated hob begins anew.
    fn restart(&mut self, _into: Program) {}
    /// Codes of bus and mains now.
    fn slow_codes(&mut self) -> Option<SlowCodes> {
        None
    }
    /// The chip's reference voltage, as converted last.
    fn reference(&mut self) -> Option<Reference> {
        None
    }
    /// Trips both comparators by their thresholds. The bridge is open and nothing asks for it.
    fn comparators(&mut self) -> Option<Comparators> {
        None
    }
    /// Begins to count the clocks; false where there are none.
    fn begin_clocks(&mut self) -> bool {
        false
    }
    /// Counts of the clocks, once they are long enough.
    fn clocks(&mut self) -> Option<Clocks> {
        None
    }
}

/// A device that is a processor alone.
pub struct NoFacilities;

impl Facilities for NoFacilities {}

/// Part of the board that is to be looked at.
#[derive(Clone, Copy)]
pub enum Test {
    /// The measuring channels.
    Channels,
    /// The trip of both comparators.
    Comparators,
    /// The clocks against each other.
    Clocks,
}

/// Order under way.
enum Order {
    /// Asked for and not looked at.
    Restart(Program),
    /// The answer is leaving; since when, in milliseconds.
    Leaving(Program, u32),
    Test(Test),
    Channels(Measuring),
    /// Counting since this time, in milliseconds.
    Clocks(u32),
}

/// Outcome of a step of an order.
enum Step {
    Next(Order),
    Answer(Answer),
    Leave(Program),
}

/// The order under way with its request's number, and the count of the link's test.
#[derive(Default)]
pub struct Service {
    order: Option<(Number, Order)>,
    received: Received,
}

impl Service {
    /// Counts what came for a test of the link.
    pub fn take_link_data(&mut self, frame: &LinkData<'_>) {
        self.received.take(frame);
    }

    /// Returns `true` if the device is about to go: nobody is paired with it any more, and nothing is heated.
    pub fn is_leaving(&self) -> bool {
        matches!(self.order, Some((_, Order::Leaving(..))))
    }

    /// Forgets what a host that is gone has asked for.
    fn forget(&mut self) {
        if !self.is_leaving() {
            self.order = None;
        }
        self.received = Received::NONE;
    }
}

impl Housekeeping {
    /// Sets the identity of the device, before a host asks.
    pub fn set_identity(&mut self, identity: Identity) {
        self.queue.set_identity(identity);
    }

    /// Sets the place where the log is kept until a host wants it.
    pub fn set_log(&mut self, log: &'static dyn LogSource) {
        self.queue.set_log(log);
    }

    /// A new host: it has asked for nothing yet.
    pub(crate) fn forget_service(&mut self, access: &mut impl Access) {
        access.with(|rt| rt.recorder().end_raw());
        self.service.forget();
    }

    pub(crate) fn ask_restart(&mut self, number: Number, into: Program) -> Option<Answer> {
        self.begin(number, Order::Restart(into))
    }

    pub(crate) fn ask_test(&mut self, number: Number, test: Test) -> Option<Answer> {
        self.begin(number, Order::Test(test))
    }

    /// Takes an order, which is answered later, or says that there is one already.
    fn begin(&mut self, number: Number, order: Order) -> Option<Answer> {
        if self.service.order.is_some() {
            return Some(outcome(Outcome::Busy));
        }
        self.service.order = Some((number, order));
        None
    }

    pub(crate) fn test_link(&mut self, test: &TestLink) -> Answer {
        if usize::from(test.bytes) > CHUNK_BYTES {
            return Answer::Reply(Reply {
                outcome: Outcome::OutOfRange,
                detail: 1,
            });
        }
        let tested = core::mem::take(&mut self.service.received).counts();
        self.queue.send_link_data(test.frames, test.bytes);
        Answer::LinkTested(tested)
    }

    /// To be called after each block, behind [`Housekeeping::poll`]: carries out what a host has asked the board
    /// for, a step at a time.
    #[inline(never)]
    pub fn serve(&mut self, access: &mut impl Access, board: &mut impl Facilities) {
        // A full queue would lose the answer.
        if self.queue.is_full() {
            return;
        }
        let Some((number, order)) = self.service.order.take() else {
            return;
        };
        let now_ms = access.with(|rt| rt.now_ms());
        if let Order::Leaving(into, since_ms) = order {
            if now_ms.wrapping_sub(since_ms) >= RESTART_AFTER_MS {
                board.restart(into);
            }
            self.service.order = Some((number, order));
            return;
        }
        let step = if self.is_off(access) {
            self.step(order, now_ms, access, board)
        } else {
            access.with(|rt| rt.recorder().end_raw());
            Step::Answer(outcome(Outcome::NotIdle))
        };
        match step {
            Step::Next(order) => self.service.order = Some((number, order)),
            Step::Answer(answer) => self.answer(number, answer),
            Step::Leave(into) => {
                self.answer(number, outcome(Outcome::Ok));
                self.unpair();
                self.service.order = Some((number, Order::Leaving(into, now_ms)));
            }
        }
    }

    fn step(
        &mut self,
        order: Order,
        now_ms: u32,
        access: &mut impl Access,
        board: &mut impl Facilities,
    ) -> Step {
        let answer = match order {
            Order::Restart(into) | Order::Leaving(into, _) if board.has_program(into) => {
                return Step::Leave(into);
            }
            Order::Restart(_) | Order::Leaving(..) => None,
            Order::Test(Test::Channels) => {
                return Step::Next(Order::Channels(Measuring::begin(now_ms)));
            }
            Order::Test(Test::Comparators) => board.comparators().map(Answer::Comparators),
            Order::Test(Test::Clocks) if board.begin_clocks() => {
                return Step::Next(Order::Clocks(now_ms));
            }
            Order::Test(Test::Clocks) => None,
            Order::Channels(mut measuring) => {
                if !measuring.step(now_ms, access, board.slow_codes()) {
                    return Step::Next(Order::Channels(measuring));
                }
                let found = measuring.result(board.reference()).map(Answer::Channels);
                // A window that nobody lets go of has the recorder.
                return Step::Answer(found.unwrap_or_else(|| outcome(Outcome::Busy)));
            }
            Order::Clocks(since_ms) => match board.clocks() {
                None if now_ms.wrapping_sub(since_ms) < CLOCKS_WITHIN_MS => {
                    return Step::Next(Order::Clocks(since_ms));
                }
                found => found.map(Answer::Clocks),
            },
        };
        Step::Answer(answer.unwrap_or_else(|| outcome(Outcome::Unavailable)))
    }

    /// Both switches open, nothing asks for anything else, and the samples are the ADC's.
    fn is_off(&self, access: &mut impl Access) -> bool {
        let asked = self.control().asked_w() > 0 && self.control().state() != State::LockedOut;
        let open = access.with(|rt| {
            let bridges = [rt.drive().bridge, rt.wanted().bridge];
            bridges == [Bridge::Open; 2] && !rt.is_replaying()
        });
        open && !asked
    }
}
