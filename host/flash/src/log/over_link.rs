//! Log of a board over its link: a low-priority message carries the frames of the RTT log.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use ihd_link::{Client, DeviceEvent, LinkError, Transport};

use super::follow::{LogChunk, LogError, LogOpener, OpenLog};
use super::running::RunningProgram;
use crate::image::BuildId;

/// Period of the requests that check the connection.
const KEEPALIVE_PERIOD: Duration = Duration::from_secs(5);

/// Time limit of the device for ending the log.
const CLOSES_WITHIN: Duration = Duration::from_millis(300);

/// Access through a link that `open` opens.
pub struct LinkLogOpener<F> {
    open: F,
    /// Boot and drop count reported last, so that reconnecting repeats nothing.
    reported: Rc<Cell<(u32, u32)>>,
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> LinkLogOpener<F> {
    /// Creates one; `open` opens the link each time.
    pub fn new(open: F) -> Self {
        Self {
            open,
            reported: Rc::default(),
        }
    }
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> LogOpener for LinkLogOpener<F> {
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
        let mut client = Client::connect((self.open)()?)?;
        let board = client.board()?;
        let running = RunningProgram {
            build: client.hello().build.as_str().to_owned(),
            build_id: BuildId::from_bytes(&board.build_id),
            crc: Some(board.sealed_crc).filter(|_| board.image_bytes > 0),
        };
        client.stream_log(true)?;
        let boot = client.hello().boot_id;
        if self.reported.get().0 != boot {
            self.reported.set((boot, 0));
        }
        let ask_at = client.clock() + KEEPALIVE_PERIOD;
        Ok(Box::new(LinkLog {
            client,
            running,
            ask_at,
            reported: Rc::clone(&self.reported),
            next: None,
        }))
    }
}

struct LinkLog {
    client: Client,
    running: RunningProgram,
    ask_at: Duration,
    reported: Rc<Cell<(u32, u32)>>,
    /// Offset of the next byte of the log; `None` before the first.
    next: Option<u32>,
}

impl LinkLog {
    /// Determines the loss before bytes of this offset.
    fn chunk(&mut self, seq: u32, dropped: u32, bytes: Vec<u8>) -> LogChunk {
        let (boot, before) = self.reported.get();
        self.reported.set((boot, dropped));
        let lost_bytes = self.next.map_or(0, |next| seq.wrapping_sub(next));
        self.next = Some(seq.wrapping_add(bytes.len() as u32));
        LogChunk {
            lost_messages: dropped.wrapping_sub(before).into(),
            lost_bytes: lost_bytes.into(),
            bytes,
        }
    }
}

impl OpenLog for LinkLog {
    fn device(&self) -> String {
        self.client.describe()
    }

    fn running(&self) -> RunningProgram {
        self.running.clone()
    }

    fn read(&mut self, wait: Duration) -> Result<LogChunk, LogError> {
        if self.client.clock() >= self.ask_at {
            self.client.status()?;
            self.ask_at = self.client.clock() + KEEPALIVE_PERIOD;
        }
        match self.client.next_event(wait)? {
            Some(DeviceEvent::Log { seq, dropped, data }) => Ok(self.chunk(seq, dropped, data)),
            // The rest belongs to an earlier request.
            Some(_) | None => Ok(LogChunk::default()),
        }
    }

    fn close(&mut self) {
        self.client.set_timeout(CLOSES_WITHIN);
        // An error is ignored: the device may be disconnected.
        let _ = self.client.stream_log(false);
    }
}

#[cfg(test)]
mod tests;
