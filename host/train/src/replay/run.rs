//! Sends the stretches to a device and to this build of its firmware, and compares what comes back.

use std::collections::VecDeque;
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::replay::{PAIRS_PER_MESSAGE, persist};
use ihd_link::{Client, Event, LinkError};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, Pair, Scales};
use ihd_shared::window::TrajectoryEntry;
use ihd_signal::Segment;

use super::compare::Outcome;
use super::reference::ReferenceDevice;
use super::stretch::{BUS_DV, Stretch};

/// Times that a link which ended is made anew.
const RECONNECTS: u32 = 8;

/// How long to wait before the link is made anew.
const RECONNECT_AFTER: Duration = Duration::from_millis(200);

/// How long a window may take: 57 kB on a serial line of 115 200 baud take 5 s.
const PATIENCE: Duration = Duration::from_secs(10);

/// How a replay runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// How much faster than the capture's own time; `None`: as fast as the link allows. It does not
    /// change the result.
    pub speed: Option<f64>,
    /// How long a window or telemetry that this build made may stay away on the device.
    pub patience: Option<Duration>,
}

/// Why a replay gave no result.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The device did not switch its power outputs off.
    #[error(
        "{device} says that it is in replay mode, but switches at {f_sw_hz} Hz; nothing was sent"
    )]
    NotLocked {
        /// The device.
        device: String,
        /// What it switches at, in hertz.
        f_sw_hz: u32,
    },
    /// The device's codes mean something else than this build's, so that the same codes give other R and L.
    #[error(
        "{device} has a front end of {theirs}, this build's firmware one of {}: only a device of the same \
         scales can be compared bit for bit",
        Scales::OF_THIS_BUILD
    )]
    OtherScales {
        /// The device.
        device: String,
        /// Its scales.
        theirs: Scales,
    },
    /// There is nothing to replay.
    #[error(
        "nothing to replay: no stretch of the capture is a block long (three switching periods) at a \
         switching frequency of a hob (34 to 80 kHz)"
    )]
    Nothing,
}

/// A message under way: pairs and the crossing in them.
struct Part<'a> {
    pairs: &'a [Pair],
    crossing: Option<usize>,
    t_s: f64,
}

struct Run<'a> {
    connect: &'a mut dyn FnMut() -> Result<Client, LinkError>,
    device: Client,
    host: Client,
    settings: Settings,
    outcome: Outcome,
    /// What this build has said and the device still owes.
    owed: VecDeque<Event>,
    /// The device's half-cycles less this build's.
    half_cycles: Option<u32>,
}

/// Replays the segments on the device that `connect` reaches, again whenever the link ends, in codes of its
/// scales; `progress` hears how many blocks are done, and of how many.
///
/// # Errors
/// [`ReplayError`] when there is no whole result; a difference is no error.
pub fn run(
    segments: &[Segment],
    settings: Settings,
    connect: &mut dyn FnMut() -> Result<Client, LinkError>,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Outcome, ReplayError> {
    let started = Instant::now();
    let device = connect()?;
    let scales = device.front_end().scales();
    let stretches = segments.iter().filter_map(|s| Stretch::of(s, scales));
    let stretches: Vec<_> = stretches.collect();
    if stretches.is_empty() {
        return Err(ReplayError::Nothing);
    }
    if scales != Scales::OF_THIS_BUILD {
        return Err(ReplayError::OtherScales {
            device: device.describe(),
            theirs: scales,
        });
    }
    let all = stretches.iter().map(Stretch::blocks).sum();
    let mut run = Run {
        outcome: Outcome {
            device: format!("{} ({})", device.describe(), device.hello().build),
            stretches: stretches.len(),
            ..Outcome::default()
        },
        connect,
        device,
        host: Client::connect(Box::new(ReferenceDevice::default()))?,
        settings,
        owed: VecDeque::new(),
        half_cycles: None,
    };
    for (k, stretch) in stretches.iter().enumerate() {
        if k > 0 {
            run.clear_faults()?;
        }
        let outcome = run.stretch(stretch, &mut |done| progress(done, all));
        if outcome.is_err() {
            // Whatever failed, the device gets its power outputs back only through this.
            let _ = run.device.continue_replay(0).end();
        }
        outcome?;
    }
    run.judge_lost();
    run.outcome.seconds = started.elapsed().as_secs_f64();
    Ok(run.outcome)
}

impl Run<'_> {
    /// A fault that the last stretch led to must not keep the next one from beginning.
    fn clear_faults(&mut self) -> Result<(), LinkError> {
        for client in [&mut self.device, &mut self.host] {
            if persist(|| client.status())?.fault != Fault::NONE {
                persist(|| client.clear_fault())?;
            }
        }
        Ok(())
    }

    fn stretch(
        &mut self,
        stretch: &Stretch,
        progress: &mut dyn FnMut(usize),
    ) -> Result<(), ReplayError> {
        let (r, l) = prior().interpolate(stretch.f_sw_hz, 0);
        self.owed.clear();
        self.half_cycles = None;
        for client in [&mut self.device, &mut self.host] {
            client.start_replay(stretch.f_sw_hz, r, l)?;
            while client.next_event(Duration::ZERO)?.is_some() {}
            persist(|| client.stream(1, 1))?;
        }
        let status = persist(|| self.device.status())?;
        if status.f_sw_hz != 0 {
            return Err(ReplayError::NotLocked {
                device: self.device.describe(),
                f_sw_hz: status.f_sw_hz,
            });
        }
        let began = Instant::now();
        let mut taken = [0; 2];
        for (k, pairs) in stretch.pairs.chunks(PAIRS_PER_MESSAGE).enumerate() {
            let from = k * PAIRS_PER_MESSAGE;
            let part = Part {
                pairs,
                crossing: stretch.crossing_in(from, from + pairs.len()),
                t_s: stretch.block_s(from / ADC_LOCK_P),
            };
            self.pace(began, part.t_s - stretch.t0_s);
            let device = self.on_device(&part, &mut taken[0])?;
            let mut replay = self.host.continue_replay(taken[1]);
            let host = replay.message(part.pairs, part.crossing, BUS_DV)?;
            taken[1] = replay.taken();
            self.estimates(stretch, from / ADC_LOCK_P, &device, &host);
            self.events(part.t_s)?;
            self.outcome.blocks += pairs.len() / ADC_LOCK_P;
            progress(self.outcome.blocks);
        }
        for (client, taken) in [&mut self.device, &mut self.host].into_iter().zip(taken) {
            // Its own idle half-cycles are none of ours.
            persist(|| client.stream(0, 0))?;
            client.continue_replay(taken).end()?;
        }
        Ok(())
    }

    fn pace(&self, began: Instant, due_s: f64) {
        let Some(speed) = self.settings.speed else {
            return;
        };
        let due = Duration::from_secs_f64((due_s / speed).max(0.0));
        thread::sleep(due.saturating_sub(began.elapsed()));
    }

    /// One message through the device, over as many links as it takes.
    fn on_device(
        &mut self,
        part: &Part<'_>,
        taken: &mut u32,
    ) -> Result<Vec<Option<TrajectoryEntry>>, LinkError> {
        let mut replay = self.device.continue_replay(*taken);
        loop {
            let answer = replay.message(part.pairs, part.crossing, BUS_DV);
            self.outcome.repeats += replay.repeats();
            *taken = replay.taken();
            match answer {
                Err(error @ (LinkError::Closed { .. } | LinkError::Io { .. })) => {
                    self.reconnect(error)?;
                    replay = self.device.resume_replay(*taken);
                }
                other => return other,
            }
        }
    }

    /// The device stays in replay mode while the link is away, so the replay goes on where it was.
    fn reconnect(&mut self, error: LinkError) -> Result<(), LinkError> {
        if self.outcome.reconnects >= RECONNECTS {
            return Err(error);
        }
        self.outcome.reconnects += 1;
        thread::sleep(RECONNECT_AFTER);
        self.device = (self.connect)()?;
        persist(|| self.device.stream(1, 1))
    }

    fn estimates(
        &mut self,
        stretch: &Stretch,
        first: usize,
        device: &[Option<TrajectoryEntry>],
        host: &[Option<TrajectoryEntry>],
    ) {
        for (k, (device, host)) in device.iter().zip(host).enumerate() {
            let t_s = stretch.block_s(first + k);
            let number = |part: fn(&TrajectoryEntry) -> i32| {
                [device, host].map(|e| e.as_ref().map(|e| i64::from(part(e))))
            };
            let words = |x: &Option<i64>| x.map_or("none".to_owned(), |x| x.to_string());
            let ([r, r_host], [l, l_host]) = (number(|e| e.r.0), number(|e| e.l.0));
            self.outcome.value(t_s, "R, µΩ", r, r_host, words);
            self.outcome.value(t_s, "L, pH", l, l_host, words);
            self.outcome.estimates += 1;
        }
    }

    /// Takes what this build says now and waits for the device to say the same.
    fn events(&mut self, t_s: f64) -> Result<(), LinkError> {
        while let Some(event) = self.host.next_event(Duration::ZERO)? {
            self.owed.push_back(event);
        }
        let patience = self.settings.patience.unwrap_or(PATIENCE);
        while !self.owed.is_empty() {
            match self.device.next_event(patience) {
                Ok(Some(event)) => self.event(t_s, &event),
                // The rest is lost; a link that ended shows at the next message.
                Ok(None) | Err(LinkError::Closed { .. } | LinkError::Io { .. }) => {
                    while let Some(lost) = self.owed.pop_front() {
                        self.lost(&lost);
                    }
                }
                Err(other) => return Err(other),
            }
        }
        Ok(())
    }

    /// What the device says and this build has no counterpart of: a window that the link has damaged
    /// or both reject, or a fault that only the device has. A window of a half-cycle that this build
    /// did not record is none of either.
    fn unmatched(&mut self, t_s: f64, device: &Event) {
        match device {
            Event::WindowRejected { reason, .. } => {
                let window =
                    |e: &Event| matches!(e, Event::Window(_) | Event::WindowRejected { .. });
                let at = self.owed.iter().position(window);
                match at.and_then(|at| self.owed.remove(at)) {
                    Some(Event::WindowRejected { reason: host, .. }) if host == *reason => {
                        self.outcome.windows.compared += 1;
                    }
                    Some(_) => self.outcome.windows.lost += 1,
                    None => {}
                }
            }
            Event::Fault(f) => {
                self.outcome
                    .value(t_s, "fault", f.fault, Fault::NONE, |f| format!("{f:?}"));
            }
            Event::Window(_) | Event::Telemetry(_) | Event::Log { .. } => {}
        }
    }

    /// On a link that lost nothing, what the device did not send is a difference.
    fn judge_lost(&mut self) {
        let (c, o) = (self.device.counters(), &self.outcome);
        let whole = (c.frames_bad, c.frames_lost, o.repeats, o.reconnects) == (0, 0, 0, 0);
        let lost = o.windows.lost + o.telemetry.lost;
        if whole {
            let words = |n: &u32| format!("{n} messages missing");
            self.outcome
                .value(0.0, "windows and telemetry", lost, 0, words);
        }
    }

    fn lost(&mut self, event: &Event) {
        match event {
            Event::Window(_) | Event::WindowRejected { .. } => self.outcome.windows.lost += 1,
            Event::Telemetry(_) => self.outcome.telemetry.lost += 1,
            Event::Fault(_) | Event::Log { .. } => {}
        }
    }

    /// Compares an event of the device with this build's of the same kind and half-cycle; what was
    /// due before it is lost.
    fn event(&mut self, t_s: f64, device: &Event) {
        let same = |host: &Event| match (device, host) {
            (Event::Window(a), Event::Window(b)) => Some((a.half_cycle, b.half_cycle)),
            (Event::Telemetry(a), Event::Telemetry(b)) => Some((a.half_cycle, b.half_cycle)),
            (Event::Fault(a), Event::Fault(b)) => Some((a.half_cycle, b.half_cycle)),
            _ => None,
        };
        let fits = |(a, b): (u32, u32)| {
            let by = a.wrapping_sub(b);
            self.half_cycles
                .is_none_or(|known| known == by)
                .then_some(by)
        };
        let found = self.owed.iter().enumerate();
        let found = found.filter_map(|(k, host)| Some((k, same(host).and_then(fits)?)));
        let Some((at, by)) = found.min() else {
            return self.unmatched(t_s, device);
        };
        let Some(host) = self.owed.remove(at) else {
            return;
        };
        match (device, &host) {
            (Event::Window(a), Event::Window(b)) => self.outcome.windows(t_s, a, b),
            (Event::Telemetry(a), Event::Telemetry(b)) => {
                self.half_cycles = Some(by);
                self.outcome.telemetries(t_s, a, b);
            }
            (Event::Fault(a), Event::Fault(b)) => {
                self.outcome
                    .value(t_s, "fault", a.fault, b.fault, |f| format!("{f:?}"));
            }
            _ => {}
        }
    }
}
