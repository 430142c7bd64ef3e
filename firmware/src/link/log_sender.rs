//! The log on its way to the host: its frames as they come, while the host has it streamed.

use core::sync::atomic::Ordering;

use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::messages::{Log, Raw};

use crate::link::frame_writer::FrameWriter;
use crate::link::log_ring::LinkLog;

/// Bytes of log in one message: all that is kept, as a frame of it is sent whole.
pub const LOG_BYTES: usize = 512;

/// The log, and the bytes sent so far.
#[derive(Default)]
pub struct LogSender {
    log: Option<&'static LinkLog>,
    streaming: bool,
    /// Bytes of log that were sent.
    sent: u32,
}

impl LogSender {
    /// Sets the place where the log is kept until it is sent.
    pub fn set_log(&mut self, log: &'static LinkLog) {
        self.log = Some(log);
    }

    /// Sends the log from now on, or no more; returns `false` if there is none.
    pub fn stream(&mut self, on: bool) -> bool {
        self.streaming = on && self.log.is_some();
        self.log.is_some()
    }

    /// Writes the oldest part of the log that was not sent; `None` if it is not streamed, or there is none.
    #[inline(never)]
    pub fn write(
        &mut self,
        frames: &mut FrameWriter,
        out: &mut [u8; MAX_ENCODED],
    ) -> Option<usize> {
        let log = self.log.filter(|_| self.streaming)?;
        let mut raw = [0; LOG_BYTES];
        let length = log.ring.take(&mut raw);
        let data = raw.get(..length).filter(|data| !data.is_empty())?;
        let seq = self.sent;
        self.sent = seq.wrapping_add(length as u32);
        let (dropped, data) = (log.dropped.load(Ordering::Relaxed), Raw(data));
        Some(frames.write(&Log { seq, dropped, data }, out))
    }
}
