//! Service: requests of a host besides heating. Identity, tests of the board with the bridge
//! open, a test of the link, a new beginning.
//!
//! ```text
//! request ─► begin: one job at a time ─► poll, after each block ─► response
//!                                           └─ calls the board's [`BoardServices`]
//! ```

use ihd_shared::wire::link_test::LinkTestCounts;
use ihd_shared::wire::messages::{Clocks, Comparators, LinkData, LinkTested, Outcome, Program};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::RESTART_AFTER_MS;

use crate::limits::BUS_MIN_DV;
use crate::link::channel_test::{ChannelTest, SlowCodes};
use crate::link::response::Response;
use crate::sampling::path::SamplingLock;
use crate::sense::bus::bus_dv;
use crate::sense::supply::Reference;

/// Longest count of the clocks before the test is given up, in milliseconds.
const CLOCKS_WITHIN_MS: u32 = 900;

/// Abilities of the board alone. A board without one of these leaves it as it stands here; it is not called again for that
/// job.
pub trait BoardServices {
    /// Returns `true` if [`BoardServices::restart`] leads there.
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
    /// Trips both comparators by their thresholds. The bridge is open and not requested.
    fn comparators(&mut self) -> Option<Comparators> {
        None
    }
    /// Begins to count the clocks; returns `false` where there are none.
    fn begin_clocks(&mut self) -> bool {
        false
    }
    /// Counts of the clocks, once they are long enough.
    fn clocks(&mut self) -> Option<Clocks> {
        None
    }
}

/// A device that is a processor alone.
pub struct NoBoardServices;

impl BoardServices for NoBoardServices {}

/// Part of the board to be tested.
#[derive(Clone, Copy)]
pub enum BoardTest {
    /// The measuring channels.
    Channels,
    /// The trip of both comparators.
    Comparators,
    /// The clocks against each other.
    Clocks,
}

/// Order under way.
enum ServiceJob {
    /// Requested, not begun.
    Restart(Program),
    Test(BoardTest),
    Channels(ChannelTest),
    /// Counting since this time, in milliseconds.
    Clocks(u32),
}

/// Outcome of a step of a job.
enum Step {
    Next(ServiceJob),
    Response(Response),
    Leave(Program),
}

/// The job under way with its request's number, and the count of the link's test.
#[derive(Default)]
pub struct Service {
    job: Option<(Number, ServiceJob)>,
    /// Program that is to begin, and when its response was sent, in milliseconds.
    leaving: Option<(Program, u32)>,
    received: LinkTestCounts,
}

impl Service {
    /// Counts what came for a test of the link.
    pub fn take_link_data(&mut self, frame: &LinkData<'_>) {
        self.received.take(frame);
    }

    /// Returns `true` if the device is about to restart: no host is paired with it, and nothing is heated.
    pub fn is_leaving(&self) -> bool {
        self.leaving.is_some()
    }

    /// Forgets the requests of a host that is gone.
    pub fn forget(&mut self, lock: &mut impl SamplingLock) {
        lock.with(|path| path.recorder().end_raw());
        self.job = None;
        self.received = LinkTestCounts::NONE;
    }

    /// Counts of the link's test, which begin anew.
    pub fn take_link_counts(&mut self) -> LinkTested {
        core::mem::take(&mut self.received).counts()
    }

    /// Begins a restart into a program; returns `false` while another job is under way.
    pub fn begin_restart(&mut self, number: Number, into: Program) -> bool {
        self.begin(number, ServiceJob::Restart(into))
    }

    /// Begins a test of the board; returns `false` while another job is under way.
    pub fn begin_test(&mut self, number: Number, test: BoardTest) -> bool {
        self.begin(number, ServiceJob::Test(test))
    }

    fn begin(&mut self, number: Number, job: ServiceJob) -> bool {
        let free = self.job.is_none() && !self.is_leaving();
        if free {
            self.job = Some((number, job));
        }
        free
    }

    /// Carries out a step of the job under way; returns its response once there is one, with the request's number.
    /// `idle` if no power is requested. To be called after each block.
    #[inline(never)]
    pub fn poll(
        &mut self,
        idle: bool,
        lock: &mut impl SamplingLock,
        board: &mut impl BoardServices,
    ) -> Option<(Number, Response)> {
        if self.job.is_none() && !self.is_leaving() {
            return None;
        }
        let now_ms = lock.with(|path| path.now_ms());
        if let Some((into, since_ms)) = self.leaving {
            if now_ms.wrapping_sub(since_ms) >= RESTART_AFTER_MS {
                board.restart(into);
            }
            return None;
        }
        let (number, job) = self.job.take()?;
        let step = if idle && is_bridge_open(lock) {
            job.step(now_ms, lock, board)
        } else {
            lock.with(|path| path.recorder().end_raw());
            Step::Response(Response::outcome(Outcome::NotIdle))
        };
        match step {
            Step::Next(job) => {
                self.job = Some((number, job));
                None
            }
            Step::Response(response) => Some((number, response)),
            Step::Leave(into) => {
                self.leaving = Some((into, now_ms));
                Some((number, Response::outcome(Outcome::Ok)))
            }
        }
    }
}

/// Returns `true` if the DC link is charged, or may be: ST's bootloader drives the pins of both switches (AN2606: USART1, I2C2). The
/// bus divider alone would miss it with a broken resistor; the mains has a divider of its own.
fn may_have_bus_voltage(lock: &mut impl SamplingLock, board: &mut impl BoardServices) -> bool {
    let codes = board.slow_codes();
    lock.with(|path| path.has_mains()) || codes.is_some_and(|codes| bus_dv(codes.bus) >= BUS_MIN_DV)
}

impl ServiceJob {
    fn step(
        self,
        now_ms: u32,
        lock: &mut impl SamplingLock,
        board: &mut impl BoardServices,
    ) -> Step {
        let response = match self {
            Self::Restart(into @ Program::Bootloader)
                if board.has_program(into) && may_have_bus_voltage(lock, board) =>
            {
                Some(Response::outcome(Outcome::NotIdle))
            }
            Self::Restart(into) if board.has_program(into) => {
                return Step::Leave(into);
            }
            Self::Restart(_) => None,
            Self::Test(BoardTest::Channels) => {
                return Step::Next(Self::Channels(ChannelTest::begin(now_ms)));
            }
            Self::Test(BoardTest::Comparators) => board.comparators().map(Response::Comparators),
            Self::Test(BoardTest::Clocks) if board.begin_clocks() => {
                return Step::Next(Self::Clocks(now_ms));
            }
            Self::Test(BoardTest::Clocks) => None,
            Self::Channels(mut measuring) => {
                if !measuring.step(now_ms, lock, board.slow_codes()) {
                    return Step::Next(Self::Channels(measuring));
                }
                let response = measuring.result(board.reference()).map(Response::Channels);
                // A window that no host releases occupies the recorder.
                return Step::Response(response.unwrap_or(Response::outcome(Outcome::Busy)));
            }
            Self::Clocks(since_ms) => match board.clocks() {
                None if now_ms.wrapping_sub(since_ms) < CLOCKS_WITHIN_MS => {
                    return Step::Next(Self::Clocks(since_ms));
                }
                counts => counts.map(Response::Clocks),
            },
        };
        Step::Response(response.unwrap_or(Response::outcome(Outcome::Unavailable)))
    }
}

/// Returns `true` if both switches are open, nothing requests anything else, and the samples are the ADC's.
fn is_bridge_open(lock: &mut impl SamplingLock) -> bool {
    lock.with(|path| path.is_bridge_open() && !path.is_replaying())
}
