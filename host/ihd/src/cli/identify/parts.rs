//! Identification of a capture part by part, several parts at once. Which parts there are depends on the samples alone, and each part's
//! results on that part: the number of threads changes no digit.

use std::num::NonZero;
use std::sync::atomic::{AtomicBool, Ordering};
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

/// Capture without its samples, and what was found in them.
type Examined = (Capture, Result<Examination, SurveyError>);

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

impl ManyParts<'_> {
    /// Identifies all parts, `first` being the first one, and passes their results on in order of time.
    ///
    /// # Errors
    /// If the capture cannot be read or the results cannot be written; the first part's [`SurveyError`] if nothing can be identified in
    /// any; an interruption.
    pub fn run(&mut self, first: Capture, results: &mut ResultWriter<'_>) -> Result<()> {
        let at_once = self.at_once(first.len());
        self.bar.set_length(BAR_STEPS as u64);
        let mut batch = vec![first];
        self.read_on(&mut batch, at_once)?;
        let (mut failed, mut any) = (None, false);
        while !batch.is_empty() {
            let until = batch.last().and_then(|p| p.time.at(p.len() - 1));
            let (examined, next) = self.examined(batch, at_once);
            for (capture, examined) in examined {
                match examined {
                    Ok(examined) => {
                        any = true;
                        self.bar.suspend(|| results.take(capture, examined))?;
                    }
                    Err(error) => {
                        let from_s = capture.time.at(0).unwrap_or(0.0);
                        let said = format_args!("warning: from {from_s:.3} s on: {error}");
                        self.bar.suspend(|| output::complain(said));
                        failed.get_or_insert(error);
                    }
                }
            }
            batch = match next {
                Ok(next) => next,
                Err(error) => {
                    results.finish(Some(format!("{error:#}")))?;
                    return Err(error);
                }
            };
            let share = self.parts.share();
            self.bar.set_position((share * BAR_STEPS) as u64);
            let until_s = until.unwrap_or(0.0);
            self.bar.set_message(format!("up to {until_s:.3} s"));
            if self.stop.load(Ordering::Relaxed) && !batch.is_empty() {
                let text = format!("interrupted: what was found up to {until_s:.3} s was written");
                results.finish(Some(text.clone()))?;
                bail!(text);
            }
        }
        match failed {
            Some(error) if !any => Err(error.into()),
            _ => results.finish(self.parts.incomplete().map(|i| i.to_string())),
        }
    }

    /// Number of parts of `pairs` pairs that are identified at once.
    fn at_once(&self, pairs: usize) -> usize {
        let threads = self.threads.or(thread::available_parallelism().ok());
        let fitting = MEMORY / (BYTES_PER_PAIR * pairs).max(1);
        threads.map_or(1, NonZero::get).min(fitting).max(1)
    }

    /// Reads parts until there are `at_once`, or to the end.
    fn read_on(&mut self, batch: &mut Vec<Capture>, at_once: usize) -> Result<()> {
        while batch.len() < at_once {
            match self.parts.next_part()? {
                Some(part) => batch.push(part),
                None => break,
            }
        }
        Ok(())
    }

    /// Identifies a batch, a thread each, while the next one is read.
    fn examined(
        &mut self,
        batch: Vec<Capture>,
        at_once: usize,
    ) -> (Vec<Examined>, Result<Vec<Capture>>) {
        let request = self.request;
        thread::scope(|scope| {
            let of = |mut capture: Capture| {
                scope.spawn(move || {
                    let examined = examine_taking(&mut capture, &request, &mut |_, _, _| ());
                    (capture, examined)
                })
            };
            let running: Vec<_> = batch.into_iter().map(of).collect();
            let mut next = Vec::new();
            let read = self.read_on(&mut next, at_once).map(|()| next);
            let joined = running.into_iter().map(|part| match part.join() {
                Ok(examined) => examined,
                Err(panic) => std::panic::resume_unwind(panic),
            });
            (joined.collect(), read)
        })
    }
}
