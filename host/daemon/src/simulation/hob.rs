//! Hobs of the world: a fast script, or the firmware on the simulated board.

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::AnyMessage;
use ihd_shared::wire::number::Number;

/// Names of the hobs.
pub const HOBS: [&str; 2] = ["left", "right"];

/// Simulated hob. Its time follows the world's with [`WorldHob::advance_to`].
pub trait WorldHob: Send {
    /// Returns the requested power, in watt.
    fn asked_w(&self) -> u16;

    /// Returns the active lookup.
    fn lookup(&self) -> &RlLookup;

    /// Advances to the world's time `now`.
    fn advance_to(&mut self, now: Duration);

    /// Receives a frame of the host.
    fn receive(&mut self, frame: &[u8]);

    /// Returns the next frame sent by `now`; `None` if there is none.
    fn take_sent(&mut self, now: Duration) -> Option<Vec<u8>>;

    /// Discards sent frames that have not been delivered, when the connection was cut.
    fn discard_sent(&mut self);

    /// Restarts at `now` after a loss of power.
    fn reboot(&mut self, now: Duration);

    /// Trips a fault.
    fn trip(&mut self);

    /// Returns `true` if only switching it off and on by hand lets it heat again.
    fn is_locked_out(&self) -> bool;
}

/// Reads a frame and applies `f` to its message; `None` if it holds none.
pub fn read_frame<R>(frame: &[u8], f: impl FnOnce(Number, &AnyMessage<'_>) -> R) -> Option<R> {
    let mut deframer = Deframer::new();
    for &byte in frame {
        if let Some(Ok(frame)) = deframer.push(byte) {
            let (number, payload) = frame.split();
            let message = AnyMessage::decode(frame.id, payload).ok()?;
            return Some(f(number, &message));
        }
    }
    None
}
