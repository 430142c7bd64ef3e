//! A board's log over its link: a low-priority message with the frames that would leave over RTT.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

use ihd_link::{Client, Event, LinkError, Transport};

use super::follow::{Chunk, LogError, OpenLog, Way};
use super::running::Running;
use crate::image::BuildId;

/// How often the device is asked whether it is still there, and hears from us.
const ASK_EVERY: Duration = Duration::from_secs(5);

/// How long the device has to say that it logs no more.
const CLOSES_WITHIN: Duration = Duration::from_millis(300);

/// A device behind a link that `open` opens.
pub struct LinkWay<F> {
    open: F,
    /// Boot and dropped frames that were told, so that a cable that comes back tells nothing twice.
    told: Rc<Cell<(u32, u32)>>,
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> LinkWay<F> {
    /// A way over the link that `open` opens, each time anew.
    pub fn new(open: F) -> Self {
        Self {
            open,
            told: Rc::default(),
        }
    }
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> Way for LinkWay<F> {
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
        let mut client = Client::connect((self.open)()?)?;
        let board = client.board()?;
        let running = Running {
            build: client.hello().build.as_str().to_owned(),
            build_id: BuildId::of(&board.build_id),
            crc: Some(board.sealed_crc).filter(|_| board.image_bytes > 0),
        };
        client.stream_log(true)?;
        let boot = client.hello().boot_id;
        if self.told.get().0 != boot {
            self.told.set((boot, 0));
        }
        let ask_at = client.clock() + ASK_EVERY;
        Ok(Box::new(LinkLog {
            client,
            running,
            ask_at,
            told: Rc::clone(&self.told),
            next: None,
        }))
    }
}

struct LinkLog {
    client: Client,
    running: Running,
    ask_at: Duration,
    told: Rc<Cell<(u32, u32)>>,
    /// Bytes of log that the device will have sent before what comes next.
    next: Option<u32>,
}

impl LinkLog {
    /// What is missing before bytes that the device numbers so.
    fn chunk(&mut self, seq: u32, dropped: u32, bytes: Vec<u8>) -> Chunk {
        let (boot, before) = self.told.get();
        self.told.set((boot, dropped));
        let lost_bytes = self.next.map_or(0, |next| seq.wrapping_sub(next));
        self.next = Some(seq.wrapping_add(bytes.len() as u32));
        Chunk {
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

    fn running(&self) -> Running {
        self.running.clone()
    }

    fn read(&mut self, wait: Duration) -> Result<Chunk, LogError> {
        if self.client.clock() >= self.ask_at {
            self.client.status()?;
            self.ask_at = self.client.clock() + ASK_EVERY;
        }
        match self.client.next_event(wait)? {
            Some(Event::Log { seq, dropped, data }) => Ok(self.chunk(seq, dropped, data)),
            // Nobody asked for the rest.
            Some(_) | None => Ok(Chunk::default()),
        }
    }

    fn close(&mut self) {
        self.client.set_timeout(CLOSES_WITHIN);
        // A device that is gone logs to nobody either.
        let _ = self.client.stream_log(false);
    }
}

#[cfg(test)]
mod tests;
