//! The copy of the link's bytes that goes to a recording.

use std::io;
use std::time::Duration;

use super::FrameSink;

/// Feeds a sink with whole frames, and keeps its failure for whoever asks.
#[derive(Default)]
pub struct Tap {
    sink: Option<Box<dyn FrameSink>>,
    failure: Option<io::Error>,
    /// The last byte was within a frame.
    mid_frame: bool,
    /// The rest of a frame whose beginning was not recorded is not recorded either.
    in_step: bool,
}

impl Tap {
    /// Feeds `sink` from the next frame on.
    pub fn open(&mut self, sink: Box<dyn FrameSink>) {
        self.sink = Some(sink);
        self.in_step = !self.mid_frame;
    }

    /// Why the sink gave up, once.
    pub fn take_failure(&mut self) -> Option<io::Error> {
        self.failure.take()
    }

    /// Ends the recording.
    pub fn close(&mut self) -> io::Result<()> {
        match (self.failure.take(), self.sink.take()) {
            (Some(failure), _) => Err(failure),
            (None, Some(sink)) => sink.finish(),
            (None, None) => Ok(()),
        }
    }

    /// Takes what has come from the device.
    pub fn take(&mut self, at: Duration, bytes: &[u8]) {
        let fed = self.feed(at, bytes);
        self.keep(fed);
        self.mid_frame = bytes.last().map_or(self.mid_frame, |&b| b != 0);
    }

    /// Takes a frame that goes to the device.
    pub fn give(&mut self, at: Duration, frame: &[u8]) {
        if let Some(sink) = &mut self.sink {
            let fed = sink.sent(at, frame);
            self.keep(fed);
        }
    }

    /// A full disk must not cost the link: the failure waits and the sink is let go.
    fn keep(&mut self, fed: io::Result<()>) {
        if let Err(failure) = fed {
            self.sink = None;
            self.failure = Some(failure);
        }
    }

    fn feed(&mut self, at: Duration, mut bytes: &[u8]) -> io::Result<()> {
        let Some(sink) = &mut self.sink else {
            return Ok(());
        };
        if !self.in_step {
            let Some(end) = bytes.iter().position(|&b| b == 0) else {
                return Ok(());
            };
            self.in_step = true;
            bytes = &bytes[end + 1..];
        }
        if bytes.is_empty() {
            return Ok(());
        }
        sink.received(at, bytes)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl FrameSink for Kept {
        fn received(&mut self, _: Duration, bytes: &[u8]) -> io::Result<()> {
            self.0.lock().unwrap().extend(bytes);
            Ok(())
        }
        fn sent(&mut self, _: Duration, _: &[u8]) -> io::Result<()> {
            Ok(())
        }
        fn finish(self: Box<Self>) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_recording_that_begins_within_a_frame_begins_with_the_next() {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let mut tap = Tap::default();
        tap.take(Duration::ZERO, &[0, 1, 2]);
        tap.open(Box::new(Kept(Arc::clone(&kept))));
        tap.take(Duration::ZERO, &[3]);
        tap.take(Duration::ZERO, &[4, 0, 0, 5]);
        tap.take(Duration::ZERO, &[6, 0]);
        assert_eq!(*kept.lock().unwrap(), [0, 5, 6, 0]);
    }
}
