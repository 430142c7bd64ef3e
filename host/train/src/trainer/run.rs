//! A whole training run: one operating point after the other, and the report.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use ihd_capture::mcap::SessionRecorder;
use ihd_link::{Client, Counters, DeviceSpec, LinkError, Window};
use ihd_map::Seen;
use ihd_pinn::{Config, Identified};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Status, Utilisation};
use ihd_signal::truth::{MapTruth, Truth};
use ihd_signal::{Remark, Severity};

use super::device::{Device, TruthSource};
use super::error::Failed;
use super::point::{self, Point};
use super::{OperatingPoint, Progress, Source, TrainerError, store};
use crate::learning::SELF_CALIBRATED;
use crate::learning::{Fit, Learning, Outcome, Taught};
use crate::lookup::{Built, MapError, judged};

/// Windows tried at one operating point before it is given up.
const TRIES: usize = 3;

/// What a run does.
pub struct Settings<'a> {
    /// Operating points.
    pub source: Source,
    /// The network's settings.
    pub pinn: Config,
    /// An existing folder for the recording, the lookups and the figure; `None` keeps nothing.
    pub store: Option<PathBuf>,
    /// Go on heating after the last power until `stop` becomes true.
    pub follow: bool,
    /// Ends the run when it becomes true; it is looked at every 100 ms, and the hob is switched off first.
    pub stop: Option<&'a AtomicBool>,
    /// Makes the link again where it is cut while following; `None` ends the run then.
    pub reopen: Option<&'a dyn Fn() -> Result<Client, LinkError>>,
    /// The truth of the lookup for the load at the end, from whoever knows it; it is asked once. `None` as on a
    /// real hob.
    pub map_truth: Option<&'a dyn Fn() -> Option<MapTruth>>,
}

/// What a run found.
pub struct Report {
    /// The device, in words.
    pub device: String,
    /// One entry per operating point.
    pub points: Vec<Point>,
    /// The last lookup.
    pub built: Option<Built>,
    /// The device at the end; none where it could not be asked any more.
    pub status: Option<Status>,
    /// How busy it was; `None` before protocol 1.3.
    pub utilisation: Option<Utilisation>,
    /// What the link counted since it was made last.
    pub counters: Counters,
    /// Windows that the gate refused.
    pub refused: u32,
    /// Wall time from the start to the first lookup active on the device, in seconds.
    pub first_lookup_s: Option<f64>,
    /// Wall time of the whole run, in seconds.
    pub total_s: f64,
    /// The last window and its identification, for the figure.
    pub last: Option<(Box<Window>, Identified, Option<Truth>)>,
    /// The last lookup against the truth, where somebody knows it.
    pub map_error: Option<MapError>,
}

pub(super) struct Run<'s, 'p> {
    pub(super) device: Device<'p>,
    pub(super) settings: &'s Settings<'s>,
    pub(super) learning: Learning,
    pub(super) report: Report,
    /// Of the device that was connected last.
    pub(super) boot_id: u32,
    /// Recordings that were begun.
    recordings: u32,
    /// The first file that could not be written; it ends nothing before the end.
    not_kept: Option<TrainerError>,
    started: Instant,
}

/// Runs the trainer on a connected device; switches the hob off at the end, whatever happened, a panic
/// included.
///
/// # Errors
/// [`Failed`] with what was found until then; the device keeps the last lookup that it accepted.
pub fn run<'a>(
    client: Client,
    truth: TruthSource,
    settings: &'a Settings<'a>,
    progress: &'a mut dyn FnMut(Progress<'_>),
) -> Result<Report, Box<Failed>> {
    let name = format!("{} ({})", client.describe(), client.hello().build);
    let mut run = Run {
        boot_id: client.hello().boot_id,
        device: Device::start(client, truth, settings.stop, progress),
        settings,
        learning: Learning::new(settings.pinn.clone()),
        report: Report {
            device: name,
            points: Vec::new(),
            built: None,
            counters: Counters::default(),
            status: None,
            utilisation: None,
            refused: 0,
            first_lookup_s: None,
            total_s: 0.0,
            last: None,
            map_error: None,
        },
        recordings: 0,
        not_kept: None,
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
        let version = self.make_room(status.lookup_version)?;
        self.learning.device_has(version);
        self.device.stream()
    }

    /// After the highest version that there is no device takes another lookup, except after a reset.
    fn make_room(&mut self, version: u32) -> Result<u32, TrainerError> {
        if version < u32::MAX {
            return Ok(version);
        }
        self.device.report(Progress::Note {
            text: "the device's lookup has the highest version that there is: it is reset",
        });
        self.device.command(|client| client.reset_lookup())?;
        Ok(0)
    }

    /// Everything from now on goes into a file of its own.
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
            recorder = recorder.flushed_by_the_wall_clock();
        }
        client.record_to(recorder);
        Ok(())
    }

    /// A new link to the device.
    pub(super) fn connected(&mut self, client: Client) {
        self.boot_id = client.hello().boot_id;
        self.device.take(client);
        if let Err(why) = self.record() {
            self.not_kept(why);
        }
    }

    /// Notes that a file could not be written.
    fn not_kept(&mut self, why: TrainerError) {
        self.device.report(Progress::Note {
            text: &why.to_string(),
        });
        self.not_kept.get_or_insert(why);
    }

    /// Switches off; the report, or why there is no whole one.
    fn end(mut self, outcome: Result<(), TrainerError>) -> Result<Report, Box<Failed>> {
        if outcome.is_ok() {
            self.look_back();
        }
        // After a failure before everything else.
        let off = match self.device.finish() {
            // It says no because it is off already.
            Err(TrainerError::Link(LinkError::Refused { .. })) => Ok(()),
            off => off,
        };
        let left_on = off.as_ref().err().map(ToString::to_string);
        if outcome.is_err() && left_on.is_none() {
            self.look_back();
        }
        if let Some(why) = self.device.finish_recording() {
            self.not_kept.get_or_insert(why.into());
        }
        self.report.counters = self.device.counters();
        self.report.total_s = self.started.elapsed().as_secs_f64();
        // Who asked to stop waits for no field model.
        if outcome.is_ok() || !self.device.is_stopped() {
            self.judge_map();
        }
        let not_kept = self.not_kept.take().map_or(Ok(()), Err);
        match outcome.and(off).and(not_kept) {
            Ok(()) => Ok(self.report),
            Err(error) => Err(Box::new(Failed {
                report: self.report,
                error,
                left_on,
            })),
        }
    }

    /// The last lookup against the truth. The recorded load of a replay is not the one on the coil.
    fn judge_map(&mut self) {
        let (Some(truth), Some(built)) = (self.settings.map_truth, &self.report.built) else {
            return;
        };
        if let Source::Powers(_) = self.settings.source {
            let judge = |truth| MapError::of(&judged(built, &truth));
            self.report.map_error = truth().map(judge);
        }
    }

    /// What the device says of the run.
    fn look_back(&mut self) {
        self.report.status = self.device.command(|client| client.status()).ok();
        self.report.utilisation = self.device.command(|client| client.utilisation()).ok();
    }

    fn all_points(&mut self) -> Result<(), TrainerError> {
        let settings = self.settings;
        match &settings.source {
            Source::Powers(powers_w) => {
                for &asked_w in powers_w {
                    let since = self.device.settle(asked_w)?;
                    let point = OperatingPoint::Heating { asked_w };
                    self.point(point, None, |device| device.window_after(since, point))?;
                }
                if let (true, Some(&asked_w)) = (settings.follow, powers_w.last()) {
                    self.follow(asked_w)?;
                }
            }
            Source::Replay(half_cycles) => {
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

    /// One window that passes the gate, identified, in the lookup and reported.
    fn point(
        &mut self,
        point: OperatingPoint,
        truth: Option<&Truth>,
        next: impl Fn(&mut Device<'_>) -> Result<Box<Window>, TrainerError>,
    ) -> Result<(), TrainerError> {
        let mut why = String::new();
        for _ in 0..TRIES {
            let window = next(&mut self.device)?;
            match self.learn(window, point, truth, true)? {
                Ok(()) => return Ok(()),
                Err(reason) => why = reason,
            }
        }
        Err(TrainerError::NoFit { point, why })
    }

    /// Learns from a window, and pushes the lookup where that says something new. Within: why the window is
    /// not fit, reported and counted.
    pub(super) fn learn(
        &mut self,
        window: Box<Window>,
        at: OperatingPoint,
        truth: Option<&Truth>,
        always: bool,
    ) -> Result<Result<(), String>, TrainerError> {
        let (device, seq) = (&mut self.device, window.seq);
        let outcome = self.learning.observe(&window, always, &mut |step| {
            device.report(Progress::Training { seq, step });
        });
        let Fit {
            identified,
            findings,
            seen,
            taught,
        } = match outcome {
            Outcome::Fit(fit) => *fit,
            Outcome::Unfit { why, .. } => {
                self.report.refused += 1;
                self.device.report(Progress::Rejected { seq, why: &why });
                return Ok(Err(why));
            }
        };
        let told = |f: &&Remark| f.severity > Severity::Info || f.code == SELF_CALIBRATED;
        for finding in findings.iter().filter(told) {
            let text = format!("window {seq}: {finding}");
            self.device.report(Progress::Note { text: &text });
        }
        if let Seen::Another { r, l, .. } = seen {
            let text = format!(
                "window {seq}: another pot, or the same one moved: R is {:.1} % and L {:.1} % from what was known, which is forgotten",
                100.0 * r,
                100.0 * l
            );
            self.device.report(Progress::Note { text: &text });
        }
        // The simulated hob knows nothing of a load that was recorded elsewhere.
        let simulated = at.asked_w().and_then(|_| self.device.truth_of(&window));
        let truth = truth.cloned().or(simulated);
        let last = self.device.last.as_ref();
        let delivered_w = last.map(|t| f64::from(t.power_mw) * 1e-3);
        let power = at.asked_w().zip(delivered_w);
        let mut point = point::compare(&window, &identified, truth.as_ref(), power);
        point.learned_errors = truth.as_ref().and_then(|truth| {
            let learned = self.learning.learned(&window, &identified);
            let known = identified.t_s.iter().zip(&learned);
            let half_cycle_s = f64::from(window.half_cycle_ns) * 1e-9;
            point::errors(
                truth,
                known.map(|(t_s, p)| (*t_s, p.r_ohm, p.l_h)),
                half_cycle_s,
            )
        });
        let (news, pushed) = match taught {
            Taught::Known => (false, Ok(())),
            Taught::News(built) => (true, self.push(*built)),
            Taught::Refused(why) => (always, Err(TrainerError::Lookup(why))),
        };
        point.lookup_version = self.report.built.as_ref().map_or(0, |b| b.lookup.version);
        if !news {
            // Following an unchanged load: the newest window stands for all of them.
            self.report.points.pop();
        }
        self.report.points.push(point);
        self.report.last = Some((window, identified, truth));
        pushed.map(Ok)
    }

    fn push(&mut self, built: Built) -> Result<(), TrainerError> {
        let version = built.lookup.version;
        if let Err(why) = self.device.update_lookup(&built.lookup) {
            self.learning.refused(version);
            return match why {
                TrainerError::Link(why @ LinkError::Refused { .. }) => {
                    Err(TrainerError::Lookup(why.to_string()))
                }
                why => Err(why),
            };
        }
        self.learning.accepted(version);
        if self.report.first_lookup_s.is_none() {
            self.report.first_lookup_s = Some(self.started.elapsed().as_secs_f64());
        }
        if let Some(store) = &self.settings.store
            && let Err(why) = store::save(store, &built)
        {
            self.not_kept(why);
        }
        self.report.built = Some(built);
        Ok(())
    }
}
