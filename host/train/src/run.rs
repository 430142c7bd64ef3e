//! A whole training run: the operating points, the lookup, the report.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ihd_capture::mcap::SessionRecorder;
use ihd_identify::network;
use ihd_link::{Client, Counters, Window};
use ihd_pinn::{Config, Identified, Parameters, PinnError, identify};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::plausible;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::Status;
use ihd_signal::truth::Truth;
use serde::Serialize;

use super::gate::{GateVerdict, judge};
use super::point::{self, Point};
use super::session::{Progress, Session, TruthSource};
use super::{OperatingPoint, Source, TrainerError};
use crate::lookup::{Built, LoadCurve, LookupBuilder};

/// Windows tried at one operating point before it is given up.
const TRIES: usize = 3;

/// Relative difference below which two switching frequencies count as the same.
const SAME_FREQUENCY: f64 = 0.01;

/// Curves that the lookup rests on at one frequency.
const CURVES_PER_FREQUENCY: usize = 4;

/// Relative change of R or L against the active lookup from which `--follow` pushes a new one: what
/// noise of 30 dB alone does not reach, because a board keeps every lookup in its flash.
const WORTH_PUSHING: f64 = 2e-2;

/// Currents, in ampere, from which a change counts: below, noise makes it and no power depends on it.
const WORTH_PUSHING_FROM_A: f64 = 5.0;

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
    session: Session<'p>,
    settings: &'s Settings<'s>,
    /// What the lookup rests on; see [`Run::remember`].
    curves: Vec<LoadCurve>,
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
        client.record_to(SessionRecorder::create(&path, client.hello())?);
    }
    let device = format!("{} ({})", client.describe(), client.hello().build);
    let status = client.status()?;
    if status.fault != ihd_shared::fault::Fault::NONE {
        client.clear_fault()?;
    }
    let version = status.lookup_version;
    let session = Session::start(client, truth, progress)?;
    let mut run = Run {
        session,
        settings,
        curves: Vec::new(),
        version,
        warm: None,
        report: Report {
            device,
            points: Vec::new(),
            built: None,
            counters: Counters::default(),
            status,
            refused: 0,
            first_lookup_s: None,
            total_s: 0.0,
            last: None,
        },
        started,
    };
    let outcome = run.all_points();
    if outcome.is_ok() {
        run.report.status = run.session.client.status()?;
    }
    let off = run.session.finish();
    outcome?;
    off?;
    run.session.client.finish_recording()?;
    run.report.counters = run.session.client.counters();
    run.report.total_s = run.started.elapsed().as_secs_f64();
    Ok(run.report)
}

impl Run<'_, '_> {
    fn all_points(&mut self) -> Result<(), TrainerError> {
        let settings = self.settings;
        match &settings.source {
            Source::Powers(powers_w) => {
                for &asked_w in powers_w {
                    let since = self.session.settle(asked_w)?;
                    let point = OperatingPoint::Heating { asked_w };
                    self.point(point, |session| session.window_after(since, point))?;
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
                    self.point(point, |session| session.replayed_window(recorded))?;
                }
            }
        }
        Ok(())
    }

    /// One window that passes the gate, identified, taught and reported.
    fn point(
        &mut self,
        point: OperatingPoint,
        next: impl Fn(&mut Session<'_>) -> Result<Box<Window>, TrainerError>,
    ) -> Result<(), TrainerError> {
        let mut why = String::new();
        for _ in 0..TRIES {
            let window = next(&mut self.session)?;
            match self.identify(&window) {
                Ok(identified) => return self.learn(window, identified, point, true),
                Err(reason) => why = reason,
            }
        }
        Err(TrainerError::NoFit { point, why })
    }

    /// R(t) and L(t) of a window that may teach; else why not, told and counted.
    fn identify(&mut self, window: &Window) -> Result<Identified, String> {
        let outcome = self.train(window).map_err(|e| e.to_string());
        let outcome = outcome.and_then(|identified| match judge(&identified) {
            GateVerdict::Pass => Ok(identified),
            GateVerdict::Reject(why) => Err(why),
        });
        if let Err(why) = &outcome {
            self.report.refused += 1;
            let seq = window.seq;
            self.session.report(Progress::Rejected { seq, why });
        }
        outcome
    }

    fn train(&mut self, window: &Window) -> Result<Identified, PinnError> {
        let segment = window.segment();
        let config = Config {
            start: self.warm.take(),
            ..self.settings.pinn.clone()
        };
        let config = network::informed(config, &segment);
        let waveform = network::waveform(&segment, (0, segment.len()), 0.0);
        let seq = window.seq;
        let session = &mut self.session;
        identify(&waveform, &config, &mut |step| {
            session.report(Progress::Training { seq, step });
        })
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
        let truth = at.asked_w().and_then(|_| self.session.truth_of(&window));
        let last = self.session.last.as_ref();
        let delivered_w = last.map(|t| f64::from(t.power_mw) * 1e-3);
        let power = at.asked_w().zip(delivered_w);
        let mut point = point::compare(&window, &identified, truth.as_ref(), power);
        let curve = point::curve(&window, &identified);
        self.warm = Some(identified.parameters.clone());
        let news = always
            || self.report.built.as_ref().is_none_or(|built| {
                curve
                    .points
                    .iter()
                    .any(|p| differs(&built.lookup, window.f_sw_hz, p))
            });
        self.remember(curve);
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

    /// Keeps the last few curves of each frequency: enough to average noise, few enough to follow a
    /// load that changes, while what was seen at other frequencies stays.
    fn remember(&mut self, curve: LoadCurve) {
        let f_sw_hz = curve.f_sw_hz;
        let alike = |c: &LoadCurve| (c.f_sw_hz / f_sw_hz - 1.0).abs() < SAME_FREQUENCY;
        self.curves.push(curve);
        if self.curves.iter().filter(|c| alike(c)).count() > CURVES_PER_FREQUENCY
            && let Some(oldest) = self.curves.iter().position(alike)
        {
            self.curves.remove(oldest);
        }
    }

    fn push(&mut self) -> Result<(), TrainerError> {
        let version = self.version + 1;
        // A run describes the pot that stands on the coil now, so it starts from the built-in
        // prior, whatever the device was taught before.
        let mut builder = LookupBuilder::new(prior());
        for curve in &self.curves {
            builder.observe(curve, 1.0);
        }
        let built = builder
            .build(version)
            .ok_or_else(|| TrainerError::Lookup("its least-squares problem is singular".into()))?;
        // The device would refuse it for the same reason, with less to say.
        plausible::check(&built.lookup).map_err(|why| {
            TrainerError::Lookup(format!(
                "{why}; a load this far from a full-size pot (a small or off-centre one?) is not \
                 taught"
            ))
        })?;
        self.session.teach(&built.lookup)?;
        self.version = version;
        if self.report.first_lookup_s.is_none() {
            self.report.first_lookup_s = Some(self.started.elapsed().as_secs_f64());
        }
        if let Some(store) = &self.settings.store {
            save(store, &built)?;
        }
        self.report.built = Some(built);
        Ok(())
    }

    /// Identifies every window until told to stop.
    fn follow(&mut self, point: OperatingPoint, stop: &AtomicBool) -> Result<(), TrainerError> {
        let last = self.report.last.as_ref();
        let mut since = last.map_or(0, |(window, _, _)| window.half_cycle);
        while !stop.load(Ordering::Relaxed) {
            let window = self.session.window_after(since, point)?;
            since = window.half_cycle;
            if let Ok(identified) = self.identify(&window) {
                self.learn(window, identified, point, false)?;
            }
        }
        Ok(())
    }
}

fn differs(lookup: &RlLookup, f_sw_hz: u32, p: &crate::lookup::curve::LoadPoint) -> bool {
    let (r, l) = lookup.interpolate(f_sw_hz, (p.i_a * 1e3) as u32);
    if p.i_a < WORTH_PUSHING_FROM_A {
        return false;
    }
    (p.r_ohm / r.ohm() - 1.0).abs() > WORTH_PUSHING
        || (p.l_h / l.henry() - 1.0).abs() > WORTH_PUSHING
}

/// A lookup in the store: its bytes as they were pushed, and the same for people.
fn save(store: &Path, built: &Built) -> Result<(), TrainerError> {
    #[derive(Serialize)]
    struct Readable<'a> {
        version: u32,
        observed_cells: u32,
        f_sw_hz: Vec<f64>,
        i_a: Vec<f64>,
        r_ohm: Vec<Vec<f64>>,
        l_h: Vec<Vec<f64>>,
        confidence: &'a [[f64; ihd_shared::lookup::grid::CURRENTS]],
    }
    use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, current_a, frequency_hz};
    use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE};
    let cells = |cells: &[[u16; CURRENTS]; FREQUENCIES], unit: f64| {
        cells
            .iter()
            .map(|row| row.iter().map(|&c| f64::from(c) * unit).collect())
            .collect()
    };
    let lookup = &built.lookup;
    let readable = Readable {
        version: lookup.version,
        observed_cells: lookup.observed_cells(),
        f_sw_hz: (0..FREQUENCIES).map(frequency_hz).collect(),
        i_a: (0..CURRENTS).map(current_a).collect(),
        r_ohm: cells(&lookup.r, OHM_PER_CODE),
        l_h: cells(&lookup.l, HENRY_PER_CODE),
        confidence: &built.confidence,
    };
    let write = |name: String, bytes: &[u8]| {
        let path = store.join(name);
        fs::write(&path, bytes).map_err(|source| TrainerError::Write {
            path: path.display().to_string(),
            source,
        })
    };
    write(
        format!("lookup-v{}.bin", lookup.version),
        &lookup.to_bytes(),
    )?;
    let json = serde_json::to_vec_pretty(&readable)
        .map_err(|e| TrainerError::Lookup(format!("cannot be written as JSON: {e}")))?;
    write(format!("lookup-v{}.json", lookup.version), &json)
}
