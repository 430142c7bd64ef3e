//! Recording of a session with a device: every byte of the link, and the decoded messages.
//!
//! The bytes are complete: [`super::SessionReader`] derives from them the same windows, rejections and counts as the live client. The
//! decoded topics beside them are for [`super::read`] and for other tools.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::Path;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::{Duration, Instant};

use ihd_link::receiver::Receiver;
use ihd_link::{DeviceEvent, FrameSink, Window};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::CAP_SIMULATED;
use ihd_shared::wire::messages::{AnyMessage, FrontEnd, Hello, LookupBlob};
use ihd_signal::{TimeBase, current_transformer};

use super::McapFileError;
use super::cdr;
use super::notes;
use super::save::{batches, describe};
use super::topics::{FSw, META_CAPTURE, META_FREE, MainsCrossing, Topic};
use super::writer::{Existing, Writer};

/// Longest time on the transport's clock that a killed recorder may lose.
const FLUSH_PERIOD: Duration = Duration::from_millis(250);

/// Longest wall time that a killed recorder may lose if the transport's clock is the wall's, also when no more bytes come.
const WALL_CLOCK_FLUSH_PERIOD: Duration = Duration::from_millis(500);

/// Number of half-cycles remembered for their windows: two seconds.
const REMEMBERED_HALF_CYCLES: usize = 256;

/// Period at which the wall's clock is polled.
const WALL_CLOCK_POLL: Duration = Duration::from_millis(100);

/// Recorder of a session.
pub struct SessionRecorder {
    recording: Arc<Mutex<Recording>>,
    /// Dropping it ends the thread that flushes.
    flushing: Option<mpsc::Sender<()>>,
}

/// File and state of the session so far.
struct Recording {
    writer: Writer,
    /// Wall time of the oldest data not yet in the file.
    unflushed_since: Option<Instant>,
    /// Error of the last flush by the wall's clock.
    failed: Option<McapFileError>,
    receiver: Receiver,
    /// Deframer of the host's frames, for the lookups pushed.
    outgoing: Deframer,
    /// Transport's clock at the beginning.
    began: Option<Duration>,
    flushed: Duration,
    grid: Option<HalfCycleGrid>,
    /// Numbers of the last half-cycles, with the times in seconds of their telemetry.
    half_cycle_ends: VecDeque<(u32, f64)>,
}

/// Grid of the device's half-cycles in the capture's time.
#[derive(Clone, Copy)]
struct HalfCycleGrid {
    half_cycle: u32,
    zero_crossing_s: f64,
    half_cycle_s: f64,
}

impl SessionRecorder {
    /// Starts a recording of the device that sent `hello` and `front_end`.
    ///
    /// # Errors
    /// [`McapFileError::Exists`] if the file exists, else the error of the operating system.
    pub fn create(path: &Path, hello: &Hello, front_end: &FrontEnd) -> Result<Self, McapFileError> {
        Self::with_notes(path, hello, front_end, BTreeMap::new())
    }

    /// Starts a recording like [`SessionRecorder::create`], with additional notes.
    ///
    /// # Errors
    /// Any error of [`SessionRecorder::create`].
    pub fn with_notes(
        path: &Path,
        hello: &Hello,
        front_end: &FrontEnd,
        notes: BTreeMap<String, String>,
    ) -> Result<Self, McapFileError> {
        let mut writer = Writer::create(path, Existing::Keep, false)?;
        let name = format!("{} ({})", hello.board, hello.build);
        let scales = front_end.scales();
        let full_scale = [Some(scales.v_full_scale_v()), Some(scales.i_full_scale_a())];
        writer.metadata(META_CAPTURE, describe(&name, full_scale))?;
        let note = |key: &str, value: String| (key.to_owned(), value);
        let simulated = hello.capabilities & CAP_SIMULATED != 0;
        let mut all = notes;
        all.extend([
            note("device_board", hello.board.to_string()),
            note("device_build", hello.build.to_string()),
            note("device_boot_id", hello.boot_id.to_string()),
            note("device_simulated", simulated.to_string()),
            current_transformer::metadata_entry(),
            note(
                "protocol",
                format!("{}.{}", hello.protocol_major, hello.protocol_minor),
            ),
        ]);
        writer.metadata(META_FREE, all)?;
        let mut frame = [0; MAX_ENCODED];
        // The table's longest message fits a frame.
        let length = encode(hello, 0, &mut frame).unwrap_or(0);
        writer.message(Topic::FromDevice, 0.0, &frame[..length])?;
        writer.flush()?;
        let recording = Recording {
            writer,
            unflushed_since: None,
            failed: None,
            receiver: Receiver::default(),
            outgoing: Deframer::new(),
            began: None,
            flushed: Duration::ZERO,
            grid: None,
            half_cycle_ends: VecDeque::new(),
        };
        Ok(Self {
            recording: Arc::new(Mutex::new(recording)),
            flushing: None,
        })
    }

    /// Sets the time origin to `at` on the transport's clock, instead of the first byte received.
    #[must_use]
    pub fn starting_at(self, at: Duration) -> Self {
        locked(&self.recording).began = Some(at);
        self
    }

    /// Adds a thread that flushes by the wall's clock, so that the last data reaches the file even if nothing follows. Not for a
    /// hob simulated in process: there the same session gives the same bytes, and a flush ends a chunk.
    #[must_use]
    pub fn with_wall_clock_flush(mut self) -> Self {
        let (flushing, ended) = mpsc::channel();
        let recording = Arc::downgrade(&self.recording);
        // Without the thread the file is still flushed by incoming data.
        let thread = std::thread::Builder::new().name("recorder".into());
        let started = thread.spawn(move || {
            while let Err(mpsc::RecvTimeoutError::Timeout) = ended.recv_timeout(WALL_CLOCK_POLL) {
                match recording.upgrade() {
                    Some(recording) => locked(&recording).flush_by_the_wall_clock(),
                    None => return,
                }
            }
        });
        self.flushing = started.is_ok().then_some(flushing);
        self
    }

    /// Size of the file in bytes, readable from any thread.
    pub fn size(&self) -> Arc<AtomicU64> {
        locked(&self.recording).writer.size()
    }
}

/// Poisoning is ignored: the recording is as before its last message.
fn locked(recording: &Mutex<Recording>) -> MutexGuard<'_, Recording> {
    recording.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Recording {
    fn flush_by_the_wall_clock(&mut self) {
        let due = |since: Instant| since.elapsed() >= WALL_CLOCK_FLUSH_PERIOD;
        if self.failed.is_none() && self.unflushed_since.is_some_and(due) {
            self.failed = self.flush().err();
        }
    }

    fn flush(&mut self) -> Result<(), McapFileError> {
        self.unflushed_since = None;
        self.writer.flush()
    }

    fn seconds(&mut self, at: Duration) -> f64 {
        let began = *self.began.get_or_insert(at);
        at.saturating_sub(began).as_secs_f64()
    }

    fn take(&mut self, at: Duration, bytes: &[u8]) -> Result<(), McapFileError> {
        self.check_flush()?;
        let t_s = self.seconds(at);
        self.writer.message(Topic::FromDevice, t_s, bytes)?;
        for &byte in bytes {
            // Bad frames are counted, and the bytes are kept.
            let _ = self.receiver.push(byte);
        }
        while let Some(answer) = self.receiver.answers.pop_front() {
            if let Some(LookupBlob { blob }) = answer.decode()
                && let Some(note) = notes::lookup("active", blob.0)
            {
                self.writer.json(Topic::Lookup, t_s, &note)?;
            }
        }
        while let Some(event) = self.receiver.events.pop_front() {
            self.event(t_s, &event)?;
        }
        self.flush_when_due(at, t_s)
    }

    /// Returns the error of an earlier flush, which has the reason; the writer would only report that it failed.
    fn check_flush(&mut self) -> Result<(), McapFileError> {
        self.failed.take().map_or(Ok(()), Err)
    }

    fn give(&mut self, at: Duration, bytes: &[u8]) -> Result<(), McapFileError> {
        self.check_flush()?;
        let t_s = self.seconds(at);
        self.writer.message(Topic::ToDevice, t_s, bytes)?;
        for &byte in bytes {
            if let Some(Ok(frame)) = self.outgoing.push(byte)
                && let Ok(AnyMessage::PushLookup(push)) =
                    AnyMessage::decode(frame.id, frame.split().1)
                && let Some(note) = notes::lookup("pushed", push.blob.0)
            {
                self.writer.json(Topic::Lookup, t_s, &note)?;
            }
        }
        self.flush_when_due(at, t_s)
    }

    fn flush_when_due(&mut self, at: Duration, t_s: f64) -> Result<(), McapFileError> {
        if at.saturating_sub(self.flushed) < FLUSH_PERIOD {
            self.unflushed_since.get_or_insert_with(Instant::now);
            return Ok(());
        }
        self.flushed = at;
        let counters = notes::link_counters(&self.receiver.counters());
        self.writer.json(Topic::LinkCounters, t_s, &counters)?;
        self.flush()
    }

    fn finish(&mut self) -> Result<(), McapFileError> {
        self.check_flush()?;
        self.unflushed_since = None;
        let counters = notes::link_counters(&self.receiver.counters());
        let began = self.began.unwrap_or_default();
        let t_s = self.flushed.saturating_sub(began).as_secs_f64();
        self.writer.json(Topic::LinkCounters, t_s, &counters)?;
        self.writer.end()
    }

    fn event(&mut self, t_s: f64, event: &DeviceEvent) -> Result<(), McapFileError> {
        match event {
            DeviceEvent::Telemetry(t) => {
                self.note_half_cycle_end(t.half_cycle, t_s);
                self.writer
                    .json(Topic::Telemetry, t_s, &notes::telemetry(t))
            }
            DeviceEvent::Fault(f) => self.writer.json(Topic::Fault, t_s, &notes::fault(f)),
            DeviceEvent::WindowRejected { seq, reason } => {
                let note = notes::rejected(*seq, reason);
                self.writer.json(Topic::Window, t_s, &note)
            }
            DeviceEvent::Window(window) => self.window(t_s, window),
            // Decoding needs the table of the device's image; the link's bytes hold the log.
            DeviceEvent::Log { .. } => Ok(()),
        }
    }

    /// Stores the time at which a half-cycle ended, until its window has come.
    fn note_half_cycle_end(&mut self, half_cycle: u32, t_s: f64) {
        if self
            .half_cycle_ends
            .back()
            .is_some_and(|last| last.0 > half_cycle)
        {
            // The device restarted.
            self.half_cycle_ends.clear();
        }
        if self.half_cycle_ends.len() == REMEMBERED_HALF_CYCLES {
            self.half_cycle_ends.pop_front();
        }
        self.half_cycle_ends.push_back((half_cycle, t_s));
    }

    fn window(&mut self, t_s: f64, window: &Window) -> Result<(), McapFileError> {
        let zero_crossing_s = self.zero_crossing_s(t_s, window);
        let f_sw = FSw {
            t_s: zero_crossing_s,
            f_sw_hz: f64::from(window.f_sw_hz),
        };
        self.writer.json(Topic::FSw, zero_crossing_s, &f_sw)?;
        let mains = MainsCrossing {
            zero_crossing_s: Some(zero_crossing_s),
            mains_hz: Some(window.f_mains_hz()),
        };
        self.writer.json(Topic::Mains, zero_crossing_s, &mains)?;
        let time = TimeBase::Even {
            t0_s: zero_crossing_s + window.pair_time_s(0),
            dt_s: window.dt_s(),
        };
        let scales = window.scales;
        let per_code = [scales.volt_per_code(), scales.ampere_per_code()];
        for batch in batches(&time, window.pairs.len()) {
            let pairs = window.pairs[batch.from..batch.to]
                .iter()
                .map(|p| [p.v, p.i]);
            let t0_s = batch.time.t0_s();
            let message = cdr::codes(&batch.time, per_code, pairs);
            self.writer.message(Topic::Samples, t0_s, &message)?;
        }
        let note = notes::window(window, zero_crossing_s);
        self.writer.json(Topic::Window, t_s, &note)
    }

    /// Time of a window's zero crossing, on the grid of the device's half-cycles. No message carries an absolute time: the first
    /// window ended when the telemetry of its half-cycle arrived, or else when the window itself arrived, which takes some
    /// half-cycles. A grid that proves too late by whole half-cycles is moved by them, so its phase stays.
    fn zero_crossing_s(&mut self, arrived_s: f64, window: &Window) -> f64 {
        let of_window = |end: &&(u32, f64)| end.0 == window.half_cycle;
        let ended_s = self
            .half_cycle_ends
            .iter()
            .rev()
            .find(of_window)
            .map(|end| end.1);
        let over_s = ended_s.unwrap_or(arrived_s);
        let duration_s = f64::from(window.half_cycle_ns) * 1e-9;
        let fresh = |not_before_s: f64| HalfCycleGrid {
            half_cycle: window.half_cycle,
            zero_crossing_s: (over_s - duration_s).max(not_before_s),
            half_cycle_s: duration_s,
        };
        let mut grid = match self.grid {
            Some(grid) if window.half_cycle > grid.half_cycle => HalfCycleGrid {
                half_cycle: window.half_cycle,
                zero_crossing_s: grid.zero_crossing_s
                    + f64::from(window.half_cycle - grid.half_cycle) * grid.half_cycle_s,
                ..grid
            },
            // The device restarted.
            Some(grid) => fresh(grid.zero_crossing_s + grid.half_cycle_s),
            None => fresh(0.0),
        };
        if let Some(ended_s) = ended_s
            && grid.half_cycle_s > 0.0
        {
            let late = (grid.zero_crossing_s + duration_s - ended_s) / grid.half_cycle_s;
            grid.zero_crossing_s -= libm::floor(late).max(0.0) * grid.half_cycle_s;
            grid.zero_crossing_s = grid.zero_crossing_s.max(0.0);
        }
        self.grid = Some(grid);
        grid.zero_crossing_s
    }
}

impl FrameSink for SessionRecorder {
    fn received(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()> {
        let taken = locked(&self.recording).take(at, bytes);
        taken.map_err(io::Error::other)
    }

    fn sent(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()> {
        let given = locked(&self.recording).give(at, bytes);
        given.map_err(io::Error::other)
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        drop(self.flushing);
        let finished = locked(&self.recording).finish();
        finished.map_err(io::Error::other)
    }
}
