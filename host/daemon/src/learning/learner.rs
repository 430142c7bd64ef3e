//! The threads that train.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use ihd_link::Window;
use ihd_map::library::{Library, PotEntry, Provenance};
use ihd_shared::lookup::RlLookup;
use ihd_signal::truth::Truth;
use ihd_store::NewResult;
use ihd_train::learning::{Believed, Contradiction, DamagedState, Disbelief, Outcome, Taught};
use ihd_train::{Learning, NetworkConfig};
use tokio::sync::mpsc::Sender;
use tokio::sync::mpsc::error::TrySendError;

use super::answer::{Answer, Stated};
use super::answers::{Answers, Standing, WorkerFigures};
use super::figures::{LearnerFigures, Meter};
use super::outcome::{Course, Learned, Numbers, Task, Work, fit_remark};
use super::queue::{Dropped, Known, Note, Queue};
use crate::machine::Machine;

/// How often what was learned goes to the store where nothing new was.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// How long a thread that is to end waits for somebody to take its last outcome.
const LAST_WORD: Duration = Duration::from_secs(2);

/// Between two tries to hand over an outcome.
const TRY_AGAIN: Duration = Duration::from_millis(5);

/// What learning may use.
#[derive(Clone, Debug)]
pub struct LearnerSettings {
    /// Threads that train, at least one.
    pub threads: usize,
    /// Windows that may wait for them.
    pub queue: usize,
    /// The network's settings.
    pub network: NetworkConfig,
}

/// Why learning cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum LearnerError {
    /// No thread.
    #[error("cannot begin a thread that learns: {0}")]
    Thread(#[from] std::io::Error),
}

/// A thread has what was learned of a device; it is back after the window that it is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a window of the device is being learned from")]
pub struct InUse;

/// What a thread does with a window; another one in tests.
pub(super) type Study = dyn Fn(&mut Learning, &Window) -> Outcome + Send + Sync;

/// Learns from windows on threads of its own. Dropping it ends them without waiting for them.
pub struct Learner {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    network: NetworkConfig,
    limit: usize,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    study: Box<Study>,
    outcomes: Sender<Learned>,
}

#[derive(Default)]
struct State {
    queue: Queue,
    meter: Meter,
    answers: Answers,
    closing: bool,
}

impl Shared {
    /// A panic elsewhere leaves it usable: nothing that can panic happens while it is held.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Learner {
    /// Begins the threads, or none on a simulated machine.
    ///
    /// # Errors
    /// As [`Learner::start`].
    #[cfg(test)]
    pub fn start_on(
        machine: &Machine,
        settings: LearnerSettings,
        outcomes: Sender<Learned>,
    ) -> Result<Self, LearnerError> {
        match machine.disk() {
            Some(_) => Ok(Self::simulated(settings, outcomes)),
            None => Self::start(settings, outcomes),
        }
    }

    /// Begins the threads: a machine of the product is never simulated.
    ///
    /// # Errors
    /// As [`Learner::start`].
    #[cfg(not(test))]
    pub fn start_on(
        _: &Machine,
        settings: LearnerSettings,
        outcomes: Sender<Learned>,
    ) -> Result<Self, LearnerError> {
        Self::start(settings, outcomes)
    }

    /// Begins the threads; outcomes go to `outcomes`, those of one device in the order of its windows. While that
    /// channel is full, nothing is learned.
    ///
    /// # Errors
    /// [`LearnerError`] when the system has no thread left.
    pub fn start(
        settings: LearnerSettings,
        outcomes: Sender<Learned>,
    ) -> Result<Self, LearnerError> {
        let study =
            |learning: &mut Learning, window: &Window| learning.observe(window, false, &mut |_| ());
        Self::start_with(settings, outcomes, Box::new(study))
    }

    pub(super) fn start_with(
        settings: LearnerSettings,
        outcomes: Sender<Learned>,
        study: Box<Study>,
    ) -> Result<Self, LearnerError> {
        let threads = settings.threads.max(1);
        let mut learner = Self::without_threads(settings, outcomes, study);
        for n in 0..threads {
            let shared = Arc::clone(&learner.shared);
            let thread = thread::Builder::new()
                .name(format!("learner {n}"))
                .spawn(move || work(&shared))?;
            learner.threads.push(thread);
        }
        Ok(learner)
    }

    pub(super) fn without_threads(
        settings: LearnerSettings,
        outcomes: Sender<Learned>,
        study: Box<Study>,
    ) -> Self {
        let shared = Arc::new(Shared {
            state: Mutex::default(),
            changed: Condvar::new(),
            study,
            outcomes,
        });
        Self {
            shared,
            threads: Vec::new(),
            network: settings.network,
            limit: settings.queue.max(1),
        }
    }

    /// One that learns when it is told to, and then finds every window unfit.
    #[cfg(test)]
    pub fn simulated(settings: LearnerSettings, outcomes: Sender<Learned>) -> Self {
        let unfit = |_: &mut Learning, _: &Window| Outcome::Unfit {
            why: "simulated".to_owned(),
            identified: None,
            findings: Vec::new(),
        };
        Self::without_threads(settings, outcomes, Box::new(unfit))
    }

    /// Learns from the next window that waits. Returns `false` where none does, or nobody has room for what it shows.
    #[cfg(test)]
    pub fn learn_one(&self) -> bool {
        if self.shared.outcomes.capacity() == 0 {
            return false;
        }
        let next = self.shared.lock().queue.next();
        let Some((task, known)) = next else {
            return false;
        };
        learn(&self.shared, task, known);
        true
    }

    /// A device begins, or begins anew, with what was learned of it before. Damaged bytes are an error, and the
    /// device begins with nothing; a device that is known already keeps what it has where `learned` is none.
    ///
    /// # Errors
    /// [`DamagedState`].
    pub fn add(&self, device: &str, learned: Option<&[u8]>) -> Result<(), DamagedState> {
        let (learning, damage) = match learned {
            None if self.shared.lock().queue.knows(device) => return Ok(()),
            None => (Learning::new(self.network.clone()), Ok(())),
            Some(bytes) => match Learning::from_bytes(bytes, self.network.clone()) {
                Ok(learning) => (learning, Ok(())),
                Err(why) => (Learning::new(self.network.clone()), Err(why)),
            },
        };
        self.shared.lock().queue.put(device, learning);
        damage
    }

    /// The device uses the lookup of this version: after every handshake, and after its lookup was reset or
    /// pushed by somebody else.
    pub fn device_has(&self, device: &str, version: u32) {
        self.note(device, Note::DeviceHas(version));
    }

    /// The device has made a lookup of ours its own.
    pub fn accepted(&self, device: &str, version: u32) {
        self.note(device, Note::Accepted(version));
    }

    /// The device has refused a lookup of ours.
    pub fn refused(&self, device: &str, version: u32) {
        self.note(device, Note::Refused(version));
    }

    /// What was learned of a device is forgotten.
    pub fn forget(&self, device: &str) {
        self.note(device, Note::Forget);
    }

    fn note(&self, device: &str, note: Note) {
        self.shared.lock().queue.note(device, note);
    }

    /// Offers a window; never waits. A window that has to make room is returned: the oldest of the device
    /// that has most waiting. A device that was not added is.
    pub fn offer(&self, task: Task) -> Option<Dropped> {
        let mut state = self.shared.lock();
        if !state.queue.knows(&task.device) {
            let learning = Learning::new(self.network.clone());
            state.queue.put(&task.device, learning);
        }
        let dropped = state.queue.push(task, self.limit);
        state.meter.unlearned += u64::from(dropped.is_some());
        drop(state);
        self.shared.changed.notify_one();
        dropped
    }

    /// Windows of a device that were dropped before anybody could learn from them.
    pub fn unlearned(&self, device: &str) -> u64 {
        self.shared.lock().queue.unlearned(device)
    }

    /// All that was learned of a device; `None` for one that is not known, or whose window is being learned.
    pub fn state_of(&self, device: &str) -> Option<Vec<u8>> {
        let state = self.shared.lock();
        Some(state.queue.learning(device)?.to_bytes())
    }

    /// Windows that wait or are at a thread, at most.
    pub fn at_most_held(&self) -> usize {
        self.shared.lock().queue.waiting() + self.threads.len()
    }

    /// Whether the device was added, or a window of it came.
    pub fn knows(&self, device: &str) -> bool {
        self.shared.lock().queue.knows(device)
    }

    /// Whether this window waits for a thread, or one has it.
    pub fn holds(&self, device: &str, boot: u32, seq: u32) -> bool {
        self.shared.lock().queue.holds(device, boot, seq)
    }

    /// The skew in seconds that is to be taken out of the current of a device's windows, once they have shown one. While a thread has what
    /// was learned, what it was before.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        self.shared.lock().queue.skew_s(device)
    }

    /// What other hobs may learn of the pot on a device; none while a thread has what was learned, or where that is too little.
    pub fn pot_entry(&self, device: &str, by: Provenance) -> Option<PotEntry> {
        // Not while the others wait.
        let map = self.shared.lock().queue.learning(device)?.map().clone();
        map.entry(by)
    }

    /// The first place at which a lookup contradicts what a device's windows showed; `Err` while a thread has what was learned.
    ///
    /// # Errors
    /// [`InUse`].
    pub fn contradiction(
        &self,
        device: &str,
        lookup: &RlLookup,
    ) -> Result<Option<Contradiction>, InUse> {
        let state = self.shared.lock();
        match state.queue.learning(device) {
            Some(learning) => Ok(learning.contradiction(lookup)),
            None if state.queue.knows(device) => Err(InUse),
            None => Ok(None),
        }
    }

    /// Pots that other hobs know, for every device to begin with; false where they are those of before.
    pub fn use_library(&self, library: Library) -> bool {
        self.shared.lock().queue.use_library(Arc::new(library))
    }

    /// Records of workers' answers, by name.
    pub fn workers(&self) -> BTreeMap<String, WorkerFigures> {
        self.shared.lock().answers.workers().clone()
    }

    /// How busy it is.
    pub fn figures(&self) -> LearnerFigures {
        let state = self.shared.lock();
        let waiting = state.queue.waiting();
        state.meter.figures(self.threads.len(), waiting)
    }

    /// Ends the threads after the window that each is at; what waits is dropped. Waits for them: not to be
    /// called from a task that others wait for.
    pub fn stop(mut self) -> LearnerFigures {
        self.close();
        for thread in self.threads.drain(..) {
            // Panics of the training are caught; another one has been reported.
            let _ = thread.join();
        }
        self.figures()
    }

    fn close(&self) {
        let mut state = self.shared.lock();
        state.closing = true;
        let dropped = state.queue.clear();
        state.meter.unlearned += dropped as u64;
        drop(state);
        self.shared.changed.notify_all();
    }
}

impl Drop for Learner {
    fn drop(&mut self) {
        self.close();
    }
}

fn work(shared: &Shared) {
    while let Some((task, known)) = next(shared) {
        learn(shared, task, known);
    }
}

fn learn(shared: &Shared, task: Task, known: Box<Known>) {
    let device = task.device.clone();
    let began = Instant::now();
    let (mut known, mut found) = match &task.work {
        Work::Window(window) => study(shared, known, window, task.truth.as_deref()),
        Work::Answered(window, answer) => {
            match answered(shared, known, task.boot, window, answer) {
                Ok(learned) => learned,
                // Nobody else's word: it is identified here.
                Err(known) => study(shared, known, window, task.truth.as_deref()),
            }
        }
    };
    found.busy = found.busy.max(began.elapsed());
    let learned = settle(shared, &mut known, task, found);
    hand_over(shared, learned);
    let mut state = shared.lock();
    state.queue.back(&device, known);
    drop(state);
    shared.changed.notify_one();
}

fn next(shared: &Shared) -> Option<(Task, Box<Known>)> {
    let mut state = shared.lock();
    loop {
        if state.closing {
            return None;
        }
        if let Some(next) = state.queue.next() {
            return Some(next);
        }
        state = shared
            .changed
            .wait(state)
            .unwrap_or_else(PoisonError::into_inner);
    }
}

/// Learns from a window. A panic costs that window alone: the device goes on from where it was.
fn study(
    shared: &Shared,
    known: Box<Known>,
    window: &Window,
    truth: Option<&Truth>,
) -> (Box<Known>, Found) {
    let (mut known, outcome) = guarded(shared, known, |learning| (shared.study)(learning, window));
    let outcome = outcome.unwrap_or_else(|why| {
        // Whatever it was, it may have come from there.
        known.learning.start_cold();
        Outcome::Unfit {
            why,
            identified: None,
            findings: Vec::new(),
        }
    });
    (known, Found::of(window, outcome, truth))
}

/// Learns from a worker's answer that the window confirms. One that it does not confirm is recorded against the worker, and
/// what is known is handed back.
fn answered(
    shared: &Shared,
    known: Box<Known>,
    boot: u32,
    window: &Window,
    answer: &Answer,
) -> Result<(Box<Known>, Found), Box<Known>> {
    let note = |standing| note_answer(shared, answer, window.seq, standing);
    let stated = match &answer.found {
        _ if shared.lock().answers.distrust(&answer.by) => {
            note(Standing::Distrusted);
            return Err(known);
        }
        Err(_) => {
            note(Standing::Unidentified);
            return Err(known);
        }
        Ok(stated) => stated,
    };
    let skew_s = known.learning.correction().map(|c| c.skew_s);
    let (known, taken) = guarded(shared, known, |learning| {
        learning.take(boot, window, &stated.claim())
    });
    let standing = match taken {
        Ok(Ok(believed)) => {
            note(Standing::Confirmed);
            let found = Found::believed(window, stated.clone(), believed, answer.busy);
            return Ok((known, found));
        }
        Ok(Err(Disbelief::Refuted(why))) if !differ(skew_s, answer.skew_s) => {
            Standing::Refuted(why.to_string())
        }
        Ok(Err(_)) => Standing::Outdated,
        Err(panic) => Standing::Refuted(panic),
    };
    note(standing);
    Err(known)
}

/// Difference of two skews in seconds beyond which R and L differ by more than the check allows.
const SAME_SKEW_S: f64 = 1e-9;

fn differ(a: Option<f64>, b: Option<f64>) -> bool {
    (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs() > SAME_SKEW_S
}

fn note_answer(shared: &Shared, answer: &Answer, seq: u32, standing: Standing) {
    let by = &answer.by;
    if let Standing::Refuted(why) = &standing {
        tracing::warn!(
            worker = by,
            seq,
            why,
            "a worker's answer is refuted by its window"
        );
    }
    if shared.lock().answers.note(by, standing) {
        tracing::error!(
            worker = by,
            "a worker was caught too often: its answers are not looked at any more"
        );
    }
}

/// Does something with what a device has learned. A panic is an error with its message, and what was known stays.
fn guarded<T>(
    shared: &Shared,
    mut known: Box<Known>,
    work: impl FnOnce(&mut Learning) -> T,
) -> (Box<Known>, Result<T, String>) {
    let before = known.clone();
    let worked = catch_unwind(AssertUnwindSafe(|| {
        let done = work(&mut known.learning);
        (known, done)
    }));
    match worked {
        Ok((known, done)) => (known, Ok(done)),
        Err(panic) => {
            shared.lock().meter.panics += 1;
            let text = panic.downcast_ref::<&str>().copied();
            let text = text.or(panic.downcast_ref::<String>().map(String::as_str));
            let why = format!("training panicked: {}", text.unwrap_or("no message"));
            (before, Err(why))
        }
    }
}

/// Result of a window.
struct Found {
    seq: u32,
    half_cycle: u32,
    f_sw_hz: u32,
    numbers: Numbers,
    course: Course,
    refused: Option<String>,
    taught: Taught,
    busy: Duration,
}

impl Found {
    fn of(window: &Window, outcome: Outcome, truth: Option<&Truth>) -> Self {
        let (identified, findings, refused, taught) = match outcome {
            Outcome::Fit(fit) => (Some(fit.identified), fit.findings, None, fit.taught),
            Outcome::Unfit {
                why,
                identified,
                findings,
            } => (identified.map(|i| *i), findings, Some(why), Taught::Known),
        };
        let identified = identified.as_ref();
        Self {
            seq: window.seq,
            half_cycle: window.half_cycle,
            f_sw_hz: window.f_sw_hz,
            numbers: identified.map_or(Numbers::NONE, Numbers::of),
            course: Course::of(identified, &findings, truth),
            refused,
            taught,
            busy: Duration::ZERO,
        }
    }

    fn believed(window: &Window, mut stated: Stated, believed: Believed, busy: Duration) -> Self {
        stated
            .remarks
            .extend(believed.findings.iter().map(fit_remark));
        if believed.seen.is_none() {
            tracing::info!(seq = window.seq, "an answer came too late to teach");
        }
        Self {
            seq: window.seq,
            half_cycle: window.half_cycle,
            f_sw_hz: window.f_sw_hz,
            numbers: stated.numbers(&believed.confirmed),
            course: stated.into_course(believed.confirmed),
            refused: None,
            taught: believed.taught,
            busy,
        }
    }
}

/// What was told meanwhile counts, and what is to be stored is put together.
fn settle(shared: &Shared, known: &mut Known, task: Task, found: Found) -> Learned {
    let (mut news, no_lookup) = match found.taught {
        Taught::Known => (None, None),
        Taught::News(built) => (Some(built), None),
        Taught::Refused(why) => (None, Some(why)),
    };
    let notes = {
        let mut state = shared.lock();
        state.meter.count(found.busy);
        state.queue.take_notes(&task.device)
    };
    for note in notes {
        note.tell(&mut known.learning);
        if note == Note::Forget {
            news = None;
        }
    }
    let state = known.take_due_save(news.is_some(), SAVE_EVERY);
    let numbers = found.numbers;
    Learned {
        device: task.device,
        device_id: task.device_id,
        boot: task.boot,
        result: NewResult {
            session: task.session,
            seq: found.seq,
            half_cycle: found.half_cycle,
            f_sw_hz: found.f_sw_hz,
            i_crest_a: numbers.i_crest_a,
            power_w: task.power_w,
            r_ohm: numbers.r_ohm,
            l_h: numbers.l_h,
            sigma_r_pct: numbers.sigma_r_pct,
            sigma_l_pct: numbers.sigma_l_pct,
            pass: found.refused.is_none(),
            why: found.refused.unwrap_or_default(),
            changed_lookup: news.is_some(),
            iterations: numbers.iterations,
        },
        news,
        no_lookup,
        state,
        busy: found.busy,
        course: Box::new(found.course),
        stored: task.stored,
    }
}

/// Waits until somebody takes it, unless nobody is left.
fn hand_over(shared: &Shared, mut learned: Learned) {
    let mut closing_since = None;
    loop {
        match shared.outcomes.try_send(learned) {
            Ok(()) | Err(TrySendError::Closed(_)) => return,
            Err(TrySendError::Full(back)) => learned = back,
        }
        if shared.lock().closing {
            let since: Instant = *closing_since.get_or_insert_with(Instant::now);
            if since.elapsed() >= LAST_WORD {
                return;
            }
        }
        thread::sleep(TRY_AGAIN);
    }
}
