//! A board's log over its link: a low-priority message with the frames that would leave over RTT.

use std::time::Duration;

use ihd_link::{Client, Event, LinkError, Transport};

use super::follow::{Chunk, LogError, OpenLog, Way};
use super::running::Running;
use crate::image::BuildId;

/// After this long without a word from us, what a host before us asked for has lapsed: until then our words would keep
/// somebody's power alive. Status is asked for afterwards alone.
const QUIET: Duration = Duration::from_secs(11);

/// How often the device is asked whether it is still there, and hears from us.
const ASK_EVERY: Duration = Duration::from_secs(5);

/// How long the device has to say that it logs no more.
const CLOSES_WITHIN: Duration = Duration::from_millis(300);

/// A device behind a link that `open` opens.
pub struct LinkWay<F> {
    open: F,
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> LinkWay<F> {
    /// A way over the link that `open` opens, each time anew.
    pub fn new(open: F) -> Self {
        Self { open }
    }
}

impl<F: FnMut() -> Result<Box<dyn Transport>, LinkError>> Way for LinkWay<F> {
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
        let mut client = Client::connect((self.open)()?)?;
        let board = client.board()?;
        let running = Running {
            build: client.hello().build.as_str().to_owned(),
            build_id: BuildId::of(&board.build_id),
            crc: Some(board.image_crc).filter(|_| board.image_bytes > 0),
        };
        client.stream_log(true)?;
        let ask_at = client.clock() + QUIET;
        Ok(Box::new(LinkLog {
            client,
            running,
            ask_at,
        }))
    }
}

struct LinkLog {
    client: Client,
    running: Running,
    ask_at: Duration,
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
            Some(Event::Log { dropped, data }) => Ok(Chunk {
                lost: dropped.into(),
                bytes: data,
            }),
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
