//! [`Transport`] of the link over a board's bulk endpoints.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use ihd_link::{LinkError, Transport};
use ihd_shared::usb::TRANSFER;

use super::super::cable::Cable;
use super::super::transfer::{Outcome, Request, Status};

/// Emulated time within which the board must accept sent bytes, as in the host's own transport.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Number of pending transfers for the board's bytes.
const IN_FLIGHT: usize = 16;
/// Polling period of the emulated clock, in real time.
const GLANCE: Duration = Duration::from_micros(500);

/// Link over a board's bulk endpoints; its clock is the emulated one.
pub struct BulkLink {
    cable: Cable,
    serial: String,
    sender: Sender<Outcome>,
    arrived: Receiver<Outcome>,
    /// Bytes that were received and not yet read.
    left: Vec<u8>,
    /// Pending transfers for the board's bytes, the oldest first.
    waiting: VecDeque<u64>,
}

impl BulkLink {
    /// Link of an enumerated board; `serial` is for messages.
    pub(super) fn new(cable: Cable, serial: &str) -> Self {
        let (sender, arrived) = mpsc::channel();
        let (serial, left, waiting) = (serial.to_owned(), Vec::new(), VecDeque::new());
        let mut link = Self {
            cable,
            serial,
            sender,
            arrived,
            left,
            waiting,
        };
        (0..IN_FLIGHT).for_each(|_| link.ask_for_more());
        link
    }

    fn ask_for_more(&mut self) {
        let sender = self.sender.clone();
        let request = Request::In {
            endpoint: 1,
            length: TRANSFER,
        };
        let id = self
            .cable
            .submit(request, move |outcome| drop(sender.send(outcome)));
        self.waiting.push_back(id);
    }

    fn failed(&self, doing: &'static str, status: Status) -> LinkError {
        let device = self.describe();
        if status == Status::Gone {
            return LinkError::Closed { device };
        }
        let source = io::Error::other(format!("{status:?}"));
        LinkError::Io {
            device,
            doing,
            source,
        }
    }

    /// Waits for the outcome in `receiver`; returns `None` after `timeout` of emulated time.
    fn wait(
        &self,
        receiver: &Receiver<Outcome>,
        timeout: Duration,
    ) -> Result<Option<Outcome>, Status> {
        let until = self.cable.now() + timeout;
        loop {
            match receiver.recv_timeout(GLANCE) {
                Ok(outcome) if outcome.status == Status::Done => return Ok(Some(outcome)),
                Ok(outcome) => return Err(outcome.status),
                Err(RecvTimeoutError::Disconnected) => return Err(Status::Gone),
                Err(RecvTimeoutError::Timeout) if self.cable.ended() => return Err(Status::Gone),
                Err(RecvTimeoutError::Timeout) if self.cable.now() >= until => return Ok(None),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }
}

impl Drop for BulkLink {
    /// Cancels the pending transfers, so that later bytes go to the next link.
    fn drop(&mut self) {
        self.waiting.iter().for_each(|id| self.cable.cancel(*id));
    }
}

impl Transport for BulkLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let (sender, receiver) = mpsc::channel();
        let request = Request::Out {
            endpoint: 1,
            data: bytes.to_vec(),
            ends_short: false,
        };
        let id = self
            .cable
            .submit(request, move |outcome| drop(sender.send(outcome)));
        match self.wait(&receiver, SEND_TIMEOUT) {
            Ok(Some(_)) => Ok(()),
            Ok(None) => {
                self.cable.cancel(id);
                let source = io::Error::new(ErrorKind::TimedOut, "the board leaves it unread");
                Err(LinkError::Io {
                    device: self.describe(),
                    doing: "send",
                    source,
                })
            }
            Err(status) => Err(self.failed("send", status)),
        }
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        if self.left.is_empty() {
            let waited = self.wait(&self.arrived, timeout);
            let Some(outcome) = waited.map_err(|status| self.failed("receive", status))? else {
                return Ok(0);
            };
            // Transfers end in the order of their requests.
            self.waiting.pop_front();
            self.ask_for_more();
            self.left = outcome.data;
        }
        let length = self.left.len().min(buf.len());
        buf[..length].copy_from_slice(&self.left[..length]);
        self.left.drain(..length);
        Ok(length)
    }

    fn describe(&self) -> String {
        format!("usb ({}), emulated", self.serial)
    }

    fn clock(&self) -> Duration {
        self.cable.now()
    }
}
