//! Run of a replay: sends the stretches to a device and to this build of its firmware, and compares the results.

use std::collections::VecDeque;
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::replay::{PAIRS_PER_MESSAGE, retry_unanswered};
use ihd_link::{Client, DeviceEvent, LinkError};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, Pair, Scales};
use ihd_shared::window::TrajectoryEntry;
use ihd_signal::Segment;

use super::compare::{OmittedStretches, ReplayReport};
use super::reference::ReferenceDevice;
use super::stretch::{BUS_DV, Omitted, Stretch};

/// Most reconnections of the link.
const RECONNECTS: u32 = 8;

/// Pause before a reconnection.
const RECONNECT_AFTER: Duration = Duration::from_millis(200);

/// Longest wait for a window: 57 kB take 5 s on a serial line of 115 200 baud.
const WINDOW_TIMEOUT: Duration = Duration::from_secs(10);

/// Options of a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReplayOptions {
    /// Speed as a multiple of the capture's own time; `None` for as fast as the link allows. It does not change the result.
    pub speed: Option<f64>,
    /// Longest wait for a window or telemetry of the device that this build has produced; `None` for 10 s.
    pub patience: Option<Duration>,
}

/// Failure of a replay.
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
        /// Its switching frequency, in hertz.
        f_sw_hz: u32,
    },
    /// The device's ADC codes have other scales than this build's, so that the same codes give other R and L.
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
    /// No stretch of the capture can be replayed.
    #[error(
        "nothing to replay: no stretch of the capture is a block long (three switching periods) at a \
         switching frequency of a hob (34 to 80 kHz)"
    )]
    Nothing,
}

/// Pairs of one message, and the crossing in them.
struct Part<'a> {
    pairs: &'a [Pair],
    crossing: Option<usize>,
    t_s: f64,
}

struct Run<'a> {
    connect: &'a mut dyn FnMut() -> Result<Client, LinkError>,
    device: Client,
    host: Client,
    settings: ReplayOptions,
    outcome: ReplayReport,
    /// Events of this build that the device has not sent yet.
    expected: VecDeque<DeviceEvent>,
    /// Half-cycle number of the device less that of this build; `None` before the first telemetry.
    half_cycles: Option<u32>,
}

/// Replays the segments on the device that `connect` reaches, in codes of its scales, with a new connection whenever the link ends.
/// `progress` is called with the blocks done and their total.
///
/// # Errors
/// [`ReplayError`] if there is no complete result; a difference is no error.
pub fn run(
    segments: &[Segment],
    settings: ReplayOptions,
    connect: &mut dyn FnMut() -> Result<Client, LinkError>,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<ReplayReport, ReplayError> {
    let started = Instant::now();
    let device = connect()?;
    let scales = device.front_end().scales();
    let (stretches, omitted) = stretches(segments, scales);
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
        outcome: ReplayReport {
            device: format!("{} ({})", device.describe(), device.hello().build),
            stretches: stretches.len(),
            omitted,
            saturated: stretches.iter().map(Stretch::saturated).sum(),
            ..ReplayReport::default()
        },
        connect,
        device,
        host: Client::connect(Box::new(ReferenceDevice::default()))?,
        settings,
        expected: VecDeque::new(),
        half_cycles: None,
    };
    for (k, stretch) in stretches.iter().enumerate() {
        if k > 0 {
            run.clear_faults()?;
        }
        let outcome = run.stretch(stretch, &mut |done| progress(done, all));
        if outcome.is_err() {
            // Even after a failure: only this unlocks the device's power outputs.
            let _ = run.device.continue_replay(0).end();
        }
        outcome?;
    }
    run.judge_lost();
    run.outcome.seconds = started.elapsed().as_secs_f64();
    Ok(run.outcome)
}

/// Resamples what can be replayed and counts the rest.
fn stretches(segments: &[Segment], scales: Scales) -> (Vec<Stretch>, OmittedStretches) {
    let mut stretches = Vec::new();
    let mut omitted = OmittedStretches::default();
    for segment in segments {
        match Stretch::resample(segment, scales) {
            Ok(stretch) => {
                stretches.push(stretch);
                continue;
            }
            Err(Omitted::Frequency) => omitted.out_of_range += 1,
            Err(Omitted::Short) => omitted.short += 1,
        }
        omitted.samples += segment.v_v.len();
    }
    (stretches, omitted)
}

impl Run<'_> {
    /// Clears faults of the last stretch, which would prevent the next one.
    fn clear_faults(&mut self) -> Result<(), LinkError> {
        for client in [&mut self.device, &mut self.host] {
            if retry_unanswered(|| client.status())?.fault != Fault::NONE {
                retry_unanswered(|| client.clear_fault())?;
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
        self.expected.clear();
        self.half_cycles = None;
        for client in [&mut self.device, &mut self.host] {
            client.start_replay(stretch.f_sw_hz, r, l)?;
            while client.next_event(Duration::ZERO)?.is_some() {}
            retry_unanswered(|| client.stream(1, 1))?;
        }
        let status = retry_unanswered(|| self.device.status())?;
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
            // Idle half-cycles after the replay are not compared.
            retry_unanswered(|| client.stream(0, 0))?;
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

    /// Sends one message through the device, with as many reconnections as it takes.
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

    /// Reconnects. The device stays in replay mode meanwhile, so that the replay continues where it was.
    fn reconnect(&mut self, error: LinkError) -> Result<(), LinkError> {
        if self.outcome.reconnects >= RECONNECTS {
            return Err(error);
        }
        self.outcome.reconnects += 1;
        thread::sleep(RECONNECT_AFTER);
        self.device = (self.connect)()?;
        retry_unanswered(|| self.device.stream(1, 1))
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
            self.outcome.compare_value(t_s, "R, µΩ", r, r_host, words);
            self.outcome.compare_value(t_s, "L, pH", l, l_host, words);
            self.outcome.estimates += 1;
        }
    }

    /// Collects this build's events and waits for those of the device.
    fn events(&mut self, t_s: f64) -> Result<(), LinkError> {
        while let Some(event) = self.host.next_event(Duration::ZERO)? {
            self.expected.push_back(event);
        }
        let patience = self.settings.patience.unwrap_or(WINDOW_TIMEOUT);
        while !self.expected.is_empty() {
            match self.device.next_event(patience) {
                Ok(Some(event)) => self.event(t_s, &event),
                // The rest is lost; a link that ended shows at the next message.
                Ok(None) | Err(LinkError::Closed { .. } | LinkError::Io { .. }) => {
                    while let Some(lost) = self.expected.pop_front() {
                        self.lost(&lost);
                    }
                }
                Err(other) => return Err(other),
            }
        }
        Ok(())
    }

    /// Handles an event of the device without a counterpart of this build: a window that the link has damaged or both reject, or a fault
    /// of the device alone. A window of a half-cycle that this build did not record is ignored.
    fn unmatched(&mut self, t_s: f64, device: &DeviceEvent) {
        match device {
            DeviceEvent::WindowRejected { reason, .. } => {
                let window = |e: &DeviceEvent| {
                    matches!(
                        e,
                        DeviceEvent::Window(_) | DeviceEvent::WindowRejected { .. }
                    )
                };
                let at = self.expected.iter().position(window);
                match at.and_then(|at| self.expected.remove(at)) {
                    Some(DeviceEvent::WindowRejected { reason: host, .. }) if host == *reason => {
                        self.outcome.windows.compared += 1;
                    }
                    Some(_) => self.outcome.windows.lost += 1,
                    None => {}
                }
            }
            DeviceEvent::Fault(f) => {
                self.outcome
                    .compare_value(t_s, "fault", f.fault, Fault::NONE, |f| format!("{f:?}"));
            }
            DeviceEvent::Window(_) | DeviceEvent::Telemetry(_) | DeviceEvent::Log { .. } => {}
        }
    }

    /// Counts messages that the device did not send as a difference, if the link lost nothing.
    fn judge_lost(&mut self) {
        let (c, o) = (self.device.counters(), &self.outcome);
        let whole = (c.frames_bad, c.frames_lost, o.repeats, o.reconnects) == (0, 0, 0, 0);
        let lost = o.windows.lost + o.telemetry.lost;
        if whole {
            let words = |n: &u32| format!("{n} messages missing");
            self.outcome
                .compare_value(0.0, "windows and telemetry", lost, 0, words);
        }
    }

    fn lost(&mut self, event: &DeviceEvent) {
        match event {
            DeviceEvent::Window(_) | DeviceEvent::WindowRejected { .. } => {
                self.outcome.windows.lost += 1
            }
            DeviceEvent::Telemetry(_) => self.outcome.telemetry.lost += 1,
            DeviceEvent::Fault(_) | DeviceEvent::Log { .. } => {}
        }
    }

    /// Compares an event of the device with this build's of the same kind and half-cycle.
    fn event(&mut self, t_s: f64, device: &DeviceEvent) {
        let same = |host: &DeviceEvent| match (device, host) {
            (DeviceEvent::Window(a), DeviceEvent::Window(b)) => Some((a.half_cycle, b.half_cycle)),
            (DeviceEvent::Telemetry(a), DeviceEvent::Telemetry(b)) => {
                Some((a.half_cycle, b.half_cycle))
            }
            (DeviceEvent::Fault(a), DeviceEvent::Fault(b)) => Some((a.half_cycle, b.half_cycle)),
            _ => None,
        };
        let fits = |(a, b): (u32, u32)| {
            let by = a.wrapping_sub(b);
            self.half_cycles
                .is_none_or(|known| known == by)
                .then_some(by)
        };
        let found = self.expected.iter().enumerate();
        let found = found.filter_map(|(k, host)| Some((k, same(host).and_then(fits)?)));
        let Some((at, by)) = found.min() else {
            return self.unmatched(t_s, device);
        };
        let Some(host) = self.expected.remove(at) else {
            return;
        };
        match (device, &host) {
            (DeviceEvent::Window(a), DeviceEvent::Window(b)) => {
                self.outcome.compare_windows(t_s, a, b)
            }
            (DeviceEvent::Telemetry(a), DeviceEvent::Telemetry(b)) => {
                self.half_cycles = Some(by);
                self.outcome.compare_telemetry(t_s, a, b);
            }
            (DeviceEvent::Fault(a), DeviceEvent::Fault(b)) => {
                self.outcome
                    .compare_value(t_s, "fault", a.fault, b.fault, |f| format!("{f:?}"));
            }
            _ => {}
        }
    }
}
