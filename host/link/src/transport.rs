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

/// Takes a copy of the bytes on a link, with the transport's clock at each.
pub trait FrameSink: Send {
    /// Takes the next bytes of the device, in whole frames from the first byte on.
    ///
    /// # Errors
    /// What the sink's file or device reports; the client then stops recording and passes it on once.
    fn received(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()>;

    /// Takes a frame that the host sends.
    ///
    /// # Errors
    /// As [`FrameSink::received`].
    fn sent(&mut self, at: Duration, frame: &[u8]) -> io::Result<()>;

    /// The recording is over.
    ///
    /// # Errors
    /// As [`FrameSink::received`].
    fn finish(self: Box<Self>) -> io::Result<()>;
}
