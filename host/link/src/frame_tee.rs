//! Copy of the link's frames for a recording.

use std::io;
use std::time::Duration;

use super::{FrameAligner, FrameSink};

/// Passes whole frames to a sink. An error of the sink ends the recording and is kept until it is read.
#[derive(Default)]
pub struct FrameTee {
    sink: Option<Box<dyn FrameSink>>,
    failure: Option<io::Error>,
    /// Set if the last byte was within a frame.
    mid_frame: bool,
    aligner: FrameAligner,
}

impl FrameTee {
    /// Copies to `sink` from the next frame on.
    pub fn open(&mut self, sink: Box<dyn FrameSink>) {
        self.sink = Some(sink);
        self.aligner = FrameAligner::new(self.mid_frame);
    }

    /// Returns the error that ended the recording, once.
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

    /// Copies bytes received from the device.
    pub fn take(&mut self, at: Duration, bytes: &[u8]) {
        let fed = self.feed(at, bytes);
        self.keep(fed);
        self.mid_frame = bytes.last().map_or(self.mid_frame, |&b| b != 0);
    }

    /// Copies a frame sent to the device.
    pub fn give(&mut self, at: Duration, frame: &[u8]) {
        if let Some(sink) = &mut self.sink {
            let fed = sink.sent(at, frame);
            self.keep(fed);
        }
    }

    /// Drops the sink and keeps its error: a full disk must not end the link.
    fn keep(&mut self, fed: io::Result<()>) {
        if let Err(failure) = fed {
            self.sink = None;
            self.failure = Some(failure);
        }
    }

    fn feed(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()> {
        let Some(sink) = &mut self.sink else {
            return Ok(());
        };
        match self.aligner.whole_frames(bytes) {
            [] => Ok(()),
            whole => sink.received(at, whole),
        }
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
        let mut tap = FrameTee::default();
        tap.take(Duration::ZERO, &[0, 1, 2]);
        tap.open(Box::new(Kept(Arc::clone(&kept))));
        tap.take(Duration::ZERO, &[3]);
        tap.take(Duration::ZERO, &[4, 0, 0, 5]);
        tap.take(Duration::ZERO, &[6, 0]);
        assert_eq!(*kept.lock().unwrap(), [0, 5, 6, 0]);
    }
}
