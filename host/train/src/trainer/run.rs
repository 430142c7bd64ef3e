//! A whole training run: one operating point after the other, and the report.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ihd_capture::mcap::SessionRecorder;
use ihd_link::{Client, Counters, Window};
use ihd_pinn::{Config, Identified, Parameters};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Status, Utilisation};
use ihd_signal::truth::Truth;

use super::device::{Device, TruthSource};
use super::gate::{GateVerdict, judge};
use super::network::identify_window;
use super::observations::{Observations, is_news};
use super::point::{self, Point};
use super::{OperatingPoint, Progress, Source, TrainerError, store};
use crate::lookup::Built;

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
    /// Go on heating after the last power until this becomes true.
    pub follow: Option<&'a AtomicBool>,
}

/// What a run found.
pub struct Report {
    /// The device, in words.
    pub device: String,
    /// One entry per operating point.
    pub points: Vec<Point>,
    /// The last lookup.
    pub built: Option<Built>,
    /// The device at the end.
    pub status: Status,
    /// How busy it was; `None` before protocol 1.3.
    pub utilisation: Option<Utilisation>,
    /// What the link counted.
    pub counters: Counters,
    /// Windows that the gate refused.
    pub refused: u32,
    /// Wall time from the start to the first lookup active on the device, in seconds.
    pub first_lookup_s: Option<f64>,
    /// Wall time of the whole run, in seconds.
    pub total_s: f64,
    /// The last window and its identification, for the figure.
    pub last: Option<(Box<Window>, Identified, Option<Truth>)>,
}

struct Run<'s, 'p> {
    device: Device<'p>,
    settings: &'s Settings<'s>,
    observations: Observations,
    version: u32,
    warm: Option<Parameters>,
    report: Report,
    started: Instant,
}

/// Runs the trainer on a connected device; switches the hob off at the end, whatever happened.
///
/// # Errors
/// The first [`TrainerError`]; the device then keeps the last lookup it accepted.
pub fn run(
    mut client: Client,
    truth: TruthSource,
    settings: &Settings<'_>,
    progress: &mut dyn FnMut(Progress<'_>),
) -> Result<Report, TrainerError> {
    let started = Instant::now();
    if let Some(store) = &settings.store {
        let path = store.join("session.mcap");
        client.record_to(SessionRecorder::create(
            &path,
            client.hello(),
            client.front_end(),
        )?);
    }
    let name = format!("{} ({})", client.describe(), client.hello().build);
    let status = client.status()?;
    if status.fault != Fault::NONE {
        client.clear_fault()?;
    }
    let version = status.lookup_version;
    let device = Device::start(client, truth, progress)?;
    let mut run = Run {
        device,
        settings,
        observations: Observations::default(),
        version,
        warm: None,
        report: Report {
            device: name,
            points: Vec::new(),
            built: None,
            counters: Counters::default(),
            status,
            utilisation: None,
            refused: 0,
            first_lookup_s: None,
            total_s: 0.0,
            last: None,
        },
        started,
    };
    let outcome = run.all_points();
    if outcome.is_ok() {
        run.report.status = run.device.client.status()?;
        run.report.utilisation = Some(run.device.client.utilisation()?);
    }
    let off = run.device.finish();
    outcome?;
    off?;
    run.device.client.finish_recording()?;
    run.report.counters = run.device.client.counters();
    run.report.total_s = run.started.elapsed().as_secs_f64();
    Ok(run.report)
}

impl Run<'_, '_> {
    fn all_points(&mut self) -> Result<(), TrainerError> {
        let settings = self.settings;
        match &settings.source {
            Source::Powers(powers_w) => {
                for &asked_w in powers_w {
                    let since = self.device.settle(asked_w)?;
                    let point = OperatingPoint::Heating { asked_w };
                    self.point(point, |device| device.window_after(since, point))?;
                }
                if let (Some(stop), Some(&asked_w)) = (settings.follow, powers_w.last()) {
                    self.follow(OperatingPoint::Heating { asked_w }, stop)?;
                }
            }
            Source::Replay(half_cycles) => {
                for recorded in half_cycles {
                    let point = OperatingPoint::Replayed {
                        f_sw_hz: recorded.f_sw_hz,
                    };
                    self.point(point, |device| device.replayed_window(recorded))?;
                }
            }
        }
        Ok(())
    }

    /// One window that passes the gate, identified, in the lookup and reported.
    fn point(
        &mut self,
        point: OperatingPoint,
        next: impl Fn(&mut Device<'_>) -> Result<Box<Window>, TrainerError>,
    ) -> Result<(), TrainerError> {
        let mut why = String::new();
        for _ in 0..TRIES {
            let window = next(&mut self.device)?;
            match self.identify(&window) {
                Ok(identified) => return self.learn(window, identified, point, true),
                Err(reason) => why = reason,
            }
        }
        Err(TrainerError::NoFit { point, why })
    }

    /// R(t) and L(t) of a window that may enter the lookup; else why not, reported and counted.
    fn identify(&mut self, window: &Window) -> Result<Identified, String> {
        let config = Config {
            start: self.warm.take(),
            ..self.settings.pinn.clone()
        };
        let (device, seq) = (&mut self.device, window.seq);
        let outcome = identify_window(window, config, &mut |step| {
            device.report(Progress::Training { seq, step });
        });
        let outcome = outcome.map_err(|e| e.to_string());
        let outcome = outcome.and_then(|identified| match judge(&identified) {
            GateVerdict::Pass => Ok(identified),
            GateVerdict::Reject(why) => Err(why),
        });
        if let Err(why) = &outcome {
            self.report.refused += 1;
            self.device.report(Progress::Rejected { seq, why });
        }
        outcome
    }

    /// Adds a window to the lookup; pushes it when it says something new.
    fn learn(
        &mut self,
        window: Box<Window>,
        identified: Identified,
        at: OperatingPoint,
        always: bool,
    ) -> Result<(), TrainerError> {
        // The simulated hob knows nothing of a load that was recorded elsewhere.
        let truth = at.asked_w().and_then(|_| self.device.truth_of(&window));
        let last = self.device.last.as_ref();
        let delivered_w = last.map(|t| f64::from(t.power_mw) * 1e-3);
        let power = at.asked_w().zip(delivered_w);
        let mut point = point::compare(&window, &identified, truth.as_ref(), power);
        let curve = point::curve(&window, &identified);
        self.warm = Some(identified.parameters.clone());
        let active = self.report.built.as_ref();
        let news = always || active.is_none_or(|built| is_news(&curve, &built.lookup));
        self.observations.remember(curve);
        if news {
            self.push()?;
        }
        point.lookup_version = self.version;
        if !news {
            // Following an unchanged load: the newest window stands for all of them.
            self.report.points.pop();
        }
        self.report.points.push(point);
        self.report.last = Some((window, identified, truth));
        Ok(())
    }

    fn push(&mut self) -> Result<(), TrainerError> {
        let version = self.version + 1;
        let built = self.observations.build(version)?;
        self.device.update_lookup(&built.lookup)?;
        self.version = version;
        if self.report.first_lookup_s.is_none() {
            self.report.first_lookup_s = Some(self.started.elapsed().as_secs_f64());
        }
        if let Some(store) = &self.settings.store {
            store::save(store, &built)?;
        }
        self.report.built = Some(built);
        Ok(())
    }

    /// Identifies every window until told to stop.
    fn follow(&mut self, point: OperatingPoint, stop: &AtomicBool) -> Result<(), TrainerError> {
        let last = self.report.last.as_ref();
        let mut since = last.map_or(0, |(window, _, _)| window.half_cycle);
        while !stop.load(Ordering::Relaxed) {
            let window = self.device.window_after(since, point)?;
            since = window.half_cycle;
            if let Ok(identified) = self.identify(&window) {
                self.learn(window, identified, point, false)?;
            }
        }
        Ok(())
    }
}
