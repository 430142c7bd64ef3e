//! What carries the bytes, and where a copy of them may go.

use std::io;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use super::LinkError;

/// Carries bytes to one device and back. Frames mean nothing to it.
pub trait Transport: Send {
    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// [`LinkError::Closed`] when the device is gone, [`LinkError::Io`] for anything else.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Receives some bytes into `buf` and returns how many; 0 when `timeout` has passed without
    /// any. A zero `timeout` takes what is there.
    ///
    /// # Errors
    /// As [`Transport::send`].
    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError>;

    /// The device in words, for messages: `tcp:127.0.0.1:4711`.
    fn describe(&self) -> String;

    /// The clock that `timeout` is measured with: the wall's, or simulated time where the device is
    /// simulated in process. Only differences mean something.
    fn clock(&self) -> Duration {
        static START: LazyLock<Instant> = LazyLock::new(Instant::now);
        START.elapsed()
    }
}

/// Takes a copy of the bytes that a device sends, in whole frames from the first byte on.
pub trait FrameSink: Send {
    /// Takes the next bytes.
    ///
    /// # Errors
    /// What the sink's file or device says; the client then stops recording and tells it once.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
}
