//! Traits for the transport of bytes and for the recording of them.

use std::io::{self, ErrorKind};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use super::LinkError;

/// Byte stream to and from one device. It knows nothing of frames.
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

    /// Clock that `timeout` is measured with: wall time, or simulated time if the device is simulated in process. Only differences
    /// have a meaning.
    fn clock(&self) -> Duration {
        static START: LazyLock<Instant> = LazyLock::new(Instant::now);
        START.elapsed()
    }
}

/// Time limit for a device to read what was sent to it.
pub const SEND_TIMEOUT: Duration = Duration::from_secs(5);

/// Sends all of `bytes` within `timeout` of wall time. `write` gets the remaining bytes and the remaining time, and returns the
/// number of bytes written. A device that reads a byte now and then therefore cannot block the host.
pub(crate) fn send_within(
    timeout: Duration,
    bytes: &[u8],
    mut write: impl FnMut(&[u8], Duration) -> io::Result<usize>,
) -> io::Result<()> {
    let start = Instant::now();
    let mut rest = bytes;
    while !rest.is_empty() {
        let left = timeout.saturating_sub(start.elapsed());
        if left.is_zero() {
            let why = format!(
                "the device has read {} of {} bytes in {timeout:?}",
                bytes.len() - rest.len(),
                bytes.len()
            );
            return Err(io::Error::new(ErrorKind::TimedOut, why));
        }
        match write(rest, left) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(n) => rest = rest.get(n..).unwrap_or_default(),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// Receiver of a copy of the bytes on a link, each with the transport's time.
pub trait FrameSink: Send {
    /// Records the next bytes from the device; the first byte begins a frame.
    ///
    /// # Errors
    /// What the sink's file or device reports; the client then stops recording and passes it on once.
    fn received(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()>;

    /// Records a frame sent by the host.
    ///
    /// # Errors
    /// As [`FrameSink::received`].
    fn sent(&mut self, at: Duration, frame: &[u8]) -> io::Result<()>;

    /// Completes the recording.
    ///
    /// # Errors
    /// As [`FrameSink::received`].
    fn finish(self: Box<Self>) -> io::Result<()>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_reads_a_byte_now_and_then_does_not_keep_the_host() {
        let mut sent = 0;
        let error = send_within(Duration::from_millis(60), &[0; 1_000], |_, _| {
            std::thread::sleep(Duration::from_millis(10));
            sent += 1;
            Ok(1)
        });
        assert_eq!(error.unwrap_err().kind(), ErrorKind::TimedOut);
        assert!((1..20).contains(&sent), "{sent}");
    }

    #[test]
    fn all_is_sent_in_order_whatever_is_taken_at_once() {
        let bytes: Vec<u8> = (0..=255).collect();
        let mut taken = Vec::new();
        let sent = send_within(Duration::from_secs(1), &bytes, |rest, _| {
            if taken.len() % 3 == 2 {
                taken.push(rest[0]);
                return Ok(1);
            }
            let n = rest.len().min(7);
            taken.extend_from_slice(&rest[..n]);
            Ok(n)
        });
        assert!(sent.is_ok());
        assert_eq!(taken, bytes);
    }
}
