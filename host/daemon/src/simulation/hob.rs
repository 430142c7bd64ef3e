//! Hobs of the world: one as a script, many seeds an hour, and the firmware itself on the simulated board.

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::AnyMessage;
use ihd_shared::wire::number::Number;

/// A hob. Its time is the world's, as far as [`Hob::live_until`] takes it.
pub trait Hob: Send {
    /// Power that is asked for, in watt.
    fn asked_w(&self) -> u16;

    /// The lookup in use.
    fn lookup(&self) -> &RlLookup;

    /// Lives until the world's time `now`.
    fn live_until(&mut self, now: Duration);

    /// Takes a frame of the host.
    fn receive(&mut self, frame: &[u8]);

    /// Returns the next frame that has left by `now`.
    fn take_sent(&mut self, now: Duration) -> Option<Vec<u8>>;

    /// Drops the frames on their way to a host that is cut off.
    fn forget_sent(&mut self);

    /// It loses power, and begins anew at `now`.
    fn reboot(&mut self, now: Duration);

    /// A fault trips.
    fn trip(&mut self);

    /// Returns `true` if nothing but a person who switches off and on makes it heat again.
    fn is_locked_out(&self) -> bool;
}

/// Reads a whole frame; `None` where it holds no message.
pub fn read<R>(frame: &[u8], f: impl FnOnce(Number, &AnyMessage<'_>) -> R) -> Option<R> {
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
