//! Training run: one operating point after the other, and the report.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use ihd_capture::mcap::SessionRecorder;
use ihd_link::{Client, ClientCounters, DeviceSpec, LinkError, Window};
use ihd_map::CurveMatch;
use ihd_pinn::{Identification, PinnConfig};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Status, Utilisation};
use ihd_signal::truth::{MapTruth, Truth};
use ihd_signal::{Remark, Severity};

use super::device::{Device, TruthSource};
use super::error::RunFailure;
use super::point::{self, PointReport};
use super::{OperatingPoint, RunProgress, TrainerError, TrainingSource, store};
use crate::learning::SELF_CALIBRATED;
use crate::learning::{AcceptedWindow, Learning, LookupUpdate, WindowOutcome};
use crate::lookup::{BuiltLookup, LookupAccuracy, judge_cells};

/// Windows that are tried at one operating point before the run fails.
const MAX_WINDOWS: usize = 3;

/// Outcome of a window.
pub(super) enum PointOutcome {
    /// It was learned from.
    Learned,
    /// The gate refused it for this reason, which is reported and counted.
    Refused(String),
}

/// Options of a run.
pub struct RunOptions<'a> {
    /// Operating points.
    pub source: TrainingSource,
    /// The network's settings.
    pub pinn: PinnConfig,
    /// Existing folder for the recording, the lookups and the figure; `None` writes nothing.
    pub store: Option<PathBuf>,
    /// Set to go on heating and learning after the last power until `stop` becomes true.
    pub follow: bool,
    /// Flag that ends the run when it becomes true. It is checked every 100 ms; the hob is switched off first.
    pub stop: Option<&'a AtomicBool>,
    /// Function that makes a cut link again after the last power; `None` ends the run instead.
    pub reopen: Option<&'a dyn Fn() -> Result<Client, LinkError>>,
    /// Truth of the lookup for the load at the end, called once; `None` on a real hob.
    pub map_truth: Option<&'a dyn Fn() -> Option<MapTruth>>,
}

impl RunOptions<'_> {
    /// Options of a run on a hob that is there throughout: it writes nothing and ends after the last operating point.
    pub fn new(source: TrainingSource, pinn: PinnConfig) -> Self {
        Self {
            source,
            pinn,
            store: None,
            follow: false,
            stop: None,
            reopen: None,
            map_truth: None,
        }
    }
}

/// Report of a run.
pub struct RunReport {
    /// Description of the device.
    pub device: String,
    /// One entry per operating point.
    pub points: Vec<PointReport>,
    /// Last lookup; `None` if none was pushed.
    pub built: Option<BuiltLookup>,
    /// Status of the device at the end; `None` if it did not answer.
    pub status: Option<Status>,
    /// Processor load of the device; `None` if the device did not answer.
    pub utilisation: Option<Utilisation>,
    /// Counters of the last link.
    pub counters: ClientCounters,
    /// Windows that the gate refused.
    pub refused: u32,
    /// Wall time from the start to the first lookup active on the device, in seconds.
    pub first_lookup_s: Option<f64>,
    /// Wall time of the whole run, in seconds.
    pub total_s: f64,
    /// The last window and its identification, for the figure.
    pub last: Option<(Box<Window>, Identification, Option<Truth>)>,
    /// Accuracy of the last lookup; `None` if the truth is not known.
    pub map_error: Option<LookupAccuracy>,
}

pub(super) struct Run<'s, 'p> {
    pub(super) device: Device<'p>,
    pub(super) settings: &'s RunOptions<'s>,
    pub(super) learning: Learning,
    pub(super) report: RunReport,
    /// Boot of the device at the last connection.
    pub(super) boot_id: u32,
    /// Recordings that were started.
    recordings: u32,
    /// First failure to write a file; reported at the end of the run.
    write_error: Option<TrainerError>,
    started: Instant,
}

/// Runs the trainer on a connected device. The hob is switched off at the end in every case, a panic included.
///
/// # Errors
/// [`RunFailure`] with the report up to then; the device keeps the last lookup that it accepted.
pub fn run<'a>(
    client: Client,
    truth: TruthSource,
    settings: &'a RunOptions<'a>,
    progress: &'a mut dyn FnMut(RunProgress<'_>),
) -> Result<RunReport, Box<RunFailure>> {
    let name = format!("{} ({})", client.describe(), client.hello().build);
    let mut run = Run {
        boot_id: client.hello().boot_id,
        device: Device::start(client, truth, settings.stop, progress),
        settings,
        learning: Learning::new(settings.pinn.clone()),
        report: RunReport {
            device: name,
            points: Vec::new(),
            built: None,
            counters: ClientCounters::default(),
            status: None,
            utilisation: None,
            refused: 0,
            first_lookup_s: None,
            total_s: 0.0,
            last: None,
            map_error: None,
        },
        recordings: 0,
        write_error: None,
        started: Instant::now(),
    };
    let outcome = run.prepare().and_then(|()| run.all_points());
    run.end(outcome)
}

impl Run<'_, '_> {
    fn prepare(&mut self) -> Result<(), TrainerError> {
        self.record()?;
        let status = self.device.command(|client| client.status())?;
        if status.fault != Fault::NONE {
            self.device.command(|client| client.clear_fault())?;
        }
        let version = self.reset_highest_version(status.lookup_version)?;
        self.learning.set_device_version(version);
        self.device.stream()
    }

    /// Resets a lookup that has the highest version, after which the device would accept no other.
    fn reset_highest_version(&mut self, version: u32) -> Result<u32, TrainerError> {
        if version < u32::MAX {
            return Ok(version);
        }
        self.device.report(RunProgress::Note {
            text: "the device's lookup has the highest version that there is: it is reset",
        });
        self.device.command(|client| client.reset_lookup())?;
        Ok(0)
    }

    /// Starts a recording of the session in a file of its own.
    fn record(&mut self) -> Result<(), TrainerError> {
        let Some(store) = &self.settings.store else {
            return Ok(());
        };
        self.recordings += 1;
        let path = match self.recordings {
            1 => store.join("session.mcap"),
            n => store.join(format!("session-{n}.mcap")),
        };
        let client = self.device.client()?;
        let mut recorder = SessionRecorder::create(&path, client.hello(), client.front_end())?;
        if client.describe() != DeviceSpec::Sim.to_string() {
            recorder = recorder.with_wall_clock_flush();
        }
        client.record_to(recorder);
        Ok(())
    }

    /// Continues with a new link to the device.
    pub(super) fn connected(&mut self, client: Client) {
        self.boot_id = client.hello().boot_id;
        self.device.attach(client);
        if let Err(why) = self.record() {
            self.note_write_error(why);
        }
    }

    /// Notes that a file could not be written.
    fn note_write_error(&mut self, why: TrainerError) {
        self.device.report(RunProgress::Note {
            text: &why.to_string(),
        });
        self.write_error.get_or_insert(why);
    }

    /// Switches the hob off and completes the report.
    fn end(mut self, outcome: Result<(), TrainerError>) -> Result<RunReport, Box<RunFailure>> {
        if outcome.is_ok() {
            self.read_final_status();
        }
        // After a failure, switching off comes first.
        let off = match self.device.finish() {
            // Refused because it is off already.
            Err(TrainerError::Link(LinkError::Refused { .. })) => Ok(()),
            off => off,
        };
        let left_on = off.as_ref().err().map(ToString::to_string);
        if outcome.is_err() && left_on.is_none() {
            self.read_final_status();
        }
        if let Some(why) = self.device.finish_recording() {
            self.write_error.get_or_insert(why.into());
        }
        self.report.counters = self.device.counters();
        self.report.total_s = self.started.elapsed().as_secs_f64();
        // The field model takes long; skipped after ^C.
        if outcome.is_ok() || !self.device.is_stopped() {
            self.judge_map();
        }
        let write_error = self.write_error.take().map_or(Ok(()), Err);
        match outcome.and(off).and(write_error) {
            Ok(()) => Ok(self.report),
            Err(error) => Err(Box::new(RunFailure {
                report: self.report,
                error,
                left_on,
            })),
        }
    }

    /// Compares the last lookup with the truth; not after a replay, whose recorded load is not the one on the coil.
    fn judge_map(&mut self) {
        let (Some(truth), Some(built)) = (self.settings.map_truth, &self.report.built) else {
            return;
        };
        if let TrainingSource::Powers(_) = self.settings.source {
            let judge = |truth| LookupAccuracy::from_cells(&judge_cells(built, &truth));
            self.report.map_error = truth().map(judge);
        }
    }

    /// Reads status and processor load of the device.
    fn read_final_status(&mut self) {
        self.report.status = self.device.command(|client| client.status()).ok();
        self.report.utilisation = self.device.command(|client| client.utilisation()).ok();
    }

    fn all_points(&mut self) -> Result<(), TrainerError> {
        let settings = self.settings;
        match &settings.source {
            TrainingSource::Powers(powers_w) => {
                let mut last_w = None;
                for &asked_w in powers_w {
                    let (since, asked_w) = self.device.settle(asked_w)?;
                    last_w = Some(asked_w);
                    let point = OperatingPoint::Heating { asked_w };
                    self.point(point, None, |device| device.window_after(since, point))?;
                }
                if let (true, Some(asked_w)) = (settings.follow, last_w) {
                    self.follow(asked_w)?;
                }
            }
            TrainingSource::Replay(half_cycles) => {
                for recorded in half_cycles {
                    let point = OperatingPoint::Replayed {
                        f_sw_hz: recorded.f_sw_hz,
                    };
                    let truth = recorded.truth.as_ref();
                    self.point(point, truth, |device| device.replayed_window(recorded))?;
                }
            }
        }
        Ok(())
    }

    /// Learns from the first window that passes the gate, of three at most.
    fn point(
        &mut self,
        point: OperatingPoint,
        truth: Option<&Truth>,
        next: impl Fn(&mut Device<'_>) -> Result<Box<Window>, TrainerError>,
    ) -> Result<(), TrainerError> {
        let mut why = String::new();
        for _ in 0..MAX_WINDOWS {
            let window = next(&mut self.device)?;
            match self.learn(window, point, truth, true)? {
                PointOutcome::Learned => return Ok(()),
                PointOutcome::Refused(reason) => why = reason,
            }
        }
        Err(TrainerError::NoFit { point, why })
    }

    /// Learns from a window, and pushes the lookup if it has changed. `always` builds one even if nothing has.
    pub(super) fn learn(
        &mut self,
        window: Box<Window>,
        at: OperatingPoint,
        truth: Option<&Truth>,
        always: bool,
    ) -> Result<PointOutcome, TrainerError> {
        let (device, seq) = (&mut self.device, window.seq);
        let outcome = self.learning.observe(&window, always, &mut |step| {
            device.report(RunProgress::Training { seq, step });
        });
        let AcceptedWindow {
            identified,
            findings,
            seen,
            taught,
        } = match outcome {
            WindowOutcome::Accepted(accepted) => *accepted,
            WindowOutcome::Refused { why, .. } => {
                self.report.refused += 1;
                self.device.report(RunProgress::Rejected { seq, why: &why });
                return Ok(PointOutcome::Refused(why));
            }
        };
        self.report_findings(seq, &findings, &seen);
        // In a replay the truth is the recording's, not the simulated hob's.
        let simulated = at.asked_w().and_then(|_| self.device.truth_of(&window));
        let truth = truth.cloned().or(simulated);
        let mut point = self.compare(&window, &identified, at, truth.as_ref());
        let (changed, pushed) = match taught {
            LookupUpdate::Unchanged => (false, Ok(())),
            LookupUpdate::New(built) => (true, self.push(*built)),
            LookupUpdate::Refused(why) => (always, Err(TrainerError::Lookup(why))),
        };
        point.lookup_version = self.report.built.as_ref().map_or(0, |b| b.lookup.version);
        if !changed {
            // An unchanged load: the newest window replaces the one before in the report.
            self.report.points.pop();
        }
        self.report.points.push(point);
        self.report.last = Some((window, identified, truth));
        pushed.map(|()| PointOutcome::Learned)
    }

    fn report_findings(&mut self, seq: u32, findings: &[Remark], seen: &CurveMatch) {
        let noteworthy = |f: &&Remark| f.severity > Severity::Info || f.code == SELF_CALIBRATED;
        for finding in findings.iter().filter(noteworthy) {
            let text = format!("window {seq}: {finding}");
            self.device.report(RunProgress::Note { text: &text });
        }
        if let CurveMatch::Another { r, l, .. } = seen {
            let text = format!(
                "window {seq}: another pot, or the same one moved: R is {:.1} % and L {:.1} % from what was known, which is forgotten",
                100.0 * r,
                100.0 * l
            );
            self.device.report(RunProgress::Note { text: &text });
        }
    }

    /// Compares what was identified, and what all windows have taught, with the truth and the power.
    fn compare(
        &mut self,
        window: &Window,
        identified: &Identification,
        at: OperatingPoint,
        truth: Option<&Truth>,
    ) -> PointReport {
        let mut point = point::compare(window, identified, truth, at.asked_w());
        point.learned_errors = truth.and_then(|truth| {
            let learned = self.learning.predict(window, identified);
            let known = identified.t_s.iter().zip(&learned);
            let half_cycle_s = f64::from(window.half_cycle_ns) * 1e-9;
            point::errors(
                truth,
                known.map(|(t_s, p)| (*t_s, p.r_ohm, p.l_h)),
                half_cycle_s,
            )
        });
        point
    }

    fn push(&mut self, built: BuiltLookup) -> Result<(), TrainerError> {
        let version = built.lookup.version;
        if let Err(why) = self.device.update_lookup(&built.lookup) {
            self.learning.lookup_refused(version);
            return match why {
                TrainerError::Link(why @ LinkError::Refused { .. }) => {
                    Err(TrainerError::Lookup(why.to_string()))
                }
                why => Err(why),
            };
        }
        self.learning.lookup_accepted(version);
        if self.report.first_lookup_s.is_none() {
            self.report.first_lookup_s = Some(self.started.elapsed().as_secs_f64());
        }
        if let Some(store) = &self.settings.store
            && let Err(why) = store::save(store, &built)
        {
            self.note_write_error(why);
        }
        self.report.built = Some(built);
        Ok(())
    }
}
