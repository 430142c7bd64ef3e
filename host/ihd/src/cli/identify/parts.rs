//! Identification of a capture part by part, several parts at once. Which parts there are depends on the samples alone, and each part's
//! results on that part: the number of threads changes no digit.

use std::any::Any;
use std::collections::BTreeMap;
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::{Result, bail};
use ihd_gate::{Examination, ExamineOptions, examine_taking};
use ihd_signal::Capture;
use ihd_survey::SurveyError;
use indicatif::ProgressBar;

use super::super::capture_args::CaptureParts;
use super::super::output;
use super::results::ResultWriter;

/// Memory in bytes that all parts together may take, results included.
const MEMORY: usize = 200_000_000;

/// Memory in bytes that a pair takes while its part is identified, the part that is read meanwhile included.
const BYTES_PER_PAIR: usize = 32;

/// Steps of the bar over the whole capture.
const BAR_STEPS: f64 = 1000.0;

/// Parts that are read, identified or not yet written, beyond those that are identified at once: a thread then rarely waits for the
/// slowest of the others.
const MAX_PARTS_AHEAD: usize = 1;

/// Part after its identification.
struct Examined {
    /// The part without its samples.
    capture: Capture,
    /// Time of its last sample in seconds.
    until_s: f64,
    result: Result<Examination, SurveyError>,
}

/// Part by its number, identified; or the panic that ended it.
type Identified = (usize, Result<Examined, Box<dyn Any + Send>>);

/// Identification of a long capture.
pub struct ManyParts<'a> {
    /// Rest of the capture.
    pub parts: &'a mut CaptureParts,
    /// Options of every part.
    pub request: ExamineOptions<'a>,
    /// Bar over the whole capture.
    pub bar: &'a ProgressBar,
    /// Ends the work after the parts that are being identified.
    pub stop: &'a AtomicBool,
    /// Most parts at once; `None` for one a core.
    pub threads: Option<NonZero<usize>>,
}

/// Course of an identification.
#[derive(Default)]
struct Course {
    /// Error of the first part in which nothing can be identified.
    failed: Option<SurveyError>,
    /// `true` if something was identified in a part.
    any: bool,
    /// End of the last part that was written, in seconds.
    until_s: f64,
    /// Number of parts read, and of parts written.
    read: usize,
    written: usize,
    /// `true` if the capture has no further part.
    at_end: bool,
}

impl ManyParts<'_> {
    /// Identifies all parts, `first` being the first one, and passes their results on in order of time.
    ///
    /// # Errors
    /// If the capture cannot be read or the results cannot be written; the first part's [`SurveyError`] if nothing can be identified in
    /// any; an interruption.
    pub fn run(&mut self, first: Capture, results: &mut ResultWriter<'_>) -> Result<()> {
        let at_once = self.at_once(first.len());
        self.bar.set_length(BAR_STEPS as u64);
        let (parts, waiting) = mpsc::channel();
        let (done, identified) = mpsc::channel();
        let (waiting, ended) = (Mutex::new(waiting), AtomicBool::new(false));
        let (request, stop) = (self.request, self.stop);
        let mut course = Course::default();
        let unread = thread::scope(|scope| {
            for _ in 0..at_once {
                let (done, waiting, ended) = (done.clone(), &waiting, &ended);
                let goes_on = move || ![stop, ended].iter().any(|s| s.load(Ordering::Relaxed));
                scope.spawn(move || identify_all(&request, waiting, &done, goes_on));
            }
            drop(done);
            let passed_on = self.pass_on(first, at_once, parts, &identified, results, &mut course);
            ended.store(true, Ordering::Relaxed);
            passed_on
        })?;
        if let Some(error) = unread {
            results.finish(Some(format!("{error:#}")))?;
            return Err(error);
        }
        if course.written < course.read || !(course.at_end || self.parts.is_at_end()?) {
            let until_s = course.until_s;
            let text = format!("interrupted: what was found up to {until_s:.3} s was written");
            results.finish(Some(text.clone()))?;
            bail!(text);
        }
        match course.failed {
            Some(error) if !course.any => Err(error.into()),
            _ => results.finish(self.parts.incomplete().map(|i| i.to_string())),
        }
    }

    /// Number of parts of `pairs` pairs that are identified at once.
    fn at_once(&self, pairs: usize) -> usize {
        let threads = self.threads.or(thread::available_parallelism().ok());
        let fitting = MEMORY / (BYTES_PER_PAIR * pairs).max(1);
        threads.map_or(1, NonZero::get).min(fitting).max(1)
    }

    /// Hands out parts and writes their results, until all are written or an interruption; returns the error that ended the reading.
    ///
    /// # Errors
    /// If the results cannot be written.
    fn pass_on(
        &mut self,
        first: Capture,
        at_once: usize,
        parts: Sender<(usize, Capture)>,
        identified: &Receiver<Identified>,
        results: &mut ResultWriter<'_>,
        course: &mut Course,
    ) -> Result<Option<anyhow::Error>> {
        let (mut next, mut early, mut unread) = (Some(first), BTreeMap::new(), None);
        loop {
            let full = course.read - course.written >= at_once + MAX_PARTS_AHEAD;
            if !full && !course.at_end && !self.stop.load(Ordering::Relaxed) {
                let read = next
                    .take()
                    .map_or_else(|| self.parts.next_part(), |p| Ok(Some(p)));
                match read {
                    Ok(Some(part)) => {
                        // The receiver outlives the threads.
                        let _ = parts.send((course.read, part));
                        course.read += 1;
                    }
                    Ok(None) => course.at_end = true,
                    Err(error) => (course.at_end, unread) = (true, Some(error)),
                }
                continue;
            }
            if course.written == course.read {
                return Ok(unread);
            }
            // No thread is left after an interruption.
            let Ok((number, examined)) = identified.recv() else {
                return Ok(unread);
            };
            early.insert(
                number,
                examined.unwrap_or_else(|panic| resume_unwind(panic)),
            );
            while let Some(examined) = early.remove(&course.written) {
                self.write(examined, results, course)?;
                course.written += 1;
            }
        }
    }

    /// Writes the results of one part.
    fn write(
        &mut self,
        part: Examined,
        results: &mut ResultWriter<'_>,
        course: &mut Course,
    ) -> Result<()> {
        let capture = part.capture;
        course.until_s = part.until_s;
        match part.result {
            Ok(examined) => {
                course.any = true;
                self.bar.suspend(|| results.take(capture, examined))?;
            }
            Err(error) => {
                let from_s = capture.time.at(0).unwrap_or(0.0);
                let said = format_args!("warning: from {from_s:.3} s on: {error}");
                self.bar.suspend(|| output::complain(said));
                course.failed.get_or_insert(error);
            }
        }
        self.bar
            .set_position((self.parts.share() * BAR_STEPS) as u64);
        self.bar
            .set_message(format!("up to {:.3} s", course.until_s));
        Ok(())
    }
}

/// Identifies waiting parts until there are no more, or `goes_on` says no.
fn identify_all(
    request: &ExamineOptions<'_>,
    waiting: &Mutex<Receiver<(usize, Capture)>>,
    done: &Sender<Identified>,
    goes_on: impl Fn() -> bool,
) {
    let next = || {
        waiting
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .recv()
    };
    while let Ok((number, mut capture)) = next() {
        if !goes_on() {
            return;
        }
        // A thread that ended would leave the others and the writer waiting.
        let examined = catch_unwind(AssertUnwindSafe(|| {
            let last = capture.len().saturating_sub(1);
            let until_s = capture.time.at(last).unwrap_or(0.0);
            let result = examine_taking(&mut capture, request, &mut |_, _, _| ());
            Examined {
                capture,
                until_s,
                result,
            }
        }));
        if done.send((number, examined)).is_err() {
            return;
        }
    }
}
