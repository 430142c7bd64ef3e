//! Fake device for tests.

use std::time::Duration;

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{AnyMessage, FrontEnd, Hello, Message, Outcome, Reply};
use ihd_shared::wire::number::Number;

use super::{LinkError, Transport};

/// Bytes sent by the device that the host has not received yet.
#[derive(Default)]
pub struct FakeOutput {
    bytes: Vec<u8>,
    frame_seq: u16,
    /// Number of the next answer: the last request's, unless a test sets another.
    pub number: Number,
    /// Set if the link ends once these bytes are received.
    pub closed: bool,
}

impl FakeOutput {
    /// Sends a message; an answer carries `number`.
    pub fn message<M: Message>(&mut self, message: &M) {
        let mut frame = [0; MAX_ENCODED];
        let length = encode_numbered(message, self.number, self.frame_seq, &mut frame)
            .expect("fits a frame");
        self.frame_seq = self.frame_seq.wrapping_add(1);
        self.bytes.extend_from_slice(&frame[..length]);
    }

    /// Sends arbitrary bytes.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Answers the last request with `Ok`.
    pub fn done(&mut self) {
        self.reply(Outcome::Ok);
    }

    /// Answers the last request with an outcome.
    pub fn reply(&mut self, outcome: Outcome) {
        self.message(&Reply { outcome, detail: 0 });
    }

    /// Answers a hello as a compatible device does.
    pub fn greet(&mut self) {
        self.message(&hello());
    }
}

/// The device's hello.
pub fn hello() -> Hello {
    ours(ROLE_DEVICE, 0, 7, "fake 1.0", "fake")
}

/// Scales of the device's codes.
pub fn front_end() -> FrontEnd {
    FrontEnd {
        v_full_scale_mv: 1_000_000,
        i_full_scale_ma: 100_000,
        bus_full_scale_mv: 500_000,
        mains_full_scale_mv: 500_000,
        bits: 12,
    }
}

type OnMessage = dyn FnMut(&AnyMessage<'_>, &mut FakeOutput) + Send;
type OnWait = dyn FnMut(&mut FakeOutput) + Send;

/// Fake device. It answers `GetFrontEnd` by itself. Its clock advances with bytes received and time waited.
pub struct FakeDevice {
    deframer: Deframer,
    sent: FakeOutput,
    time: Duration,
    on_message: Box<OnMessage>,
    on_wait: Box<OnWait>,
}

impl FakeDevice {
    /// `on_message` answers the host's messages; `on_wait` may send if the host waits and no bytes are there.
    pub fn new(
        on_message: impl FnMut(&AnyMessage<'_>, &mut FakeOutput) + Send + 'static,
        on_wait: impl FnMut(&mut FakeOutput) + Send + 'static,
    ) -> Self {
        Self {
            deframer: Deframer::new(),
            sent: FakeOutput::default(),
            time: Duration::ZERO,
            on_message: Box::new(on_message),
            on_wait: Box::new(on_wait),
        }
    }
}

impl Transport for FakeDevice {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let (number, bytes) = frame.split();
            self.sent.number = number;
            match AnyMessage::decode(frame.id, bytes) {
                Ok(AnyMessage::GetFrontEnd(_)) => self.sent.message(&front_end()),
                Ok(message) => (self.on_message)(&message, &mut self.sent),
                Err(_) => {}
            }
        }
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        if self.sent.bytes.is_empty() {
            (self.on_wait)(&mut self.sent);
        }
        let n = self.sent.bytes.len().min(buf.len());
        if n == 0 {
            if self.sent.closed {
                return Err(LinkError::Closed {
                    device: self.describe(),
                });
            }
            self.time += timeout;
            std::thread::sleep(timeout.min(Duration::from_millis(1)));
            return Ok(0);
        }
        buf[..n].copy_from_slice(&self.sent.bytes[..n]);
        self.sent.bytes.drain(..n);
        // As over a serial line of 921,600 bit/s.
        self.time += Duration::from_nanos(10_851 * n as u64);
        Ok(n)
    }

    fn describe(&self) -> String {
        "fake".into()
    }

    fn clock(&self) -> Duration {
        self.time
    }
}
