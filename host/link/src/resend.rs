//! When a window's missing pieces are asked for again, and when no more.
//!
//! A lost frame of some seventy must not cost the window. What is missing is asked for when the window's end has
//! come or nothing more of it comes, a few pieces at a time; the device keeps the window meanwhile. One that no
//! more is asked for waits for what may still be on its way (a link that stalls loses nothing), until a
//! later one has ended or the device says that it is gone.

use std::time::Duration;

use ihd_shared::wire::messages::ResendWindow;

use super::assembler::Unfinished;

/// Pieces asked for at once: twice as many find room among a device's answers and in what a host has room for.
pub const PIECES: usize = 4;

/// Silence about a window before each time that its missing pieces are asked for, if it has not ended. The longest
/// is well below what a device keeps a window for.
const PATIENCE: [Duration; 6] = [
    Duration::from_millis(30),
    Duration::from_millis(30),
    Duration::from_millis(60),
    Duration::from_millis(100),
    Duration::from_millis(100),
    Duration::from_millis(100),
];

/// Silence about a window after which nothing of it is expected any more.
const GIVE_UP: Duration = Duration::from_secs(10);

/// What is to be done about the window under way.
#[derive(Debug, PartialEq)]
pub enum Step {
    /// Nothing before so much time has passed.
    Wait(Duration),
    /// Ask for these.
    Ask(Vec<ResendWindow>),
    /// Reject it.
    GiveUp(u32),
}

/// What has been asked for of the window under way.
#[derive(Default)]
pub struct Resend {
    window: Option<Asked>,
}

struct Asked {
    seq: u32,
    progress: u32,
    /// When the last new piece came.
    moved: Duration,
    /// When that was, or pieces were last asked for.
    since: Duration,
    /// Times that silence led to a request.
    rounds: usize,
    pieces: Vec<ResendWindow>,
}

impl Resend {
    /// The next step, now. `asks` tells whether the device can be asked.
    pub fn step(&mut self, now: Duration, window: Option<&Unfinished<'_>>, asks: bool) -> Step {
        let Some(window) = window else {
            self.window = None;
            return Step::Wait(Duration::MAX);
        };
        let known = self.window.take().filter(|asked| asked.seq == window.seq());
        let asked = self.window.insert(known.unwrap_or_else(|| Asked {
            seq: window.seq(),
            progress: window.progress(),
            moved: now,
            since: now,
            rounds: 0,
            pieces: Vec::new(),
        }));
        if asked.progress != window.progress() {
            asked.progress = window.progress();
            (asked.moved, asked.since, asked.rounds) = (now, now, 0);
        }
        if now.saturating_sub(asked.moved) >= GIVE_UP {
            return Step::GiveUp(asked.seq);
        }
        let left = (asked.moved + GIVE_UP).saturating_sub(now);
        if !asks {
            return Step::Wait(left);
        }
        let silence = now.saturating_sub(asked.since);
        let patience = PATIENCE.get(asked.rounds).copied();
        let impatient = patience.is_some_and(|patience| silence >= patience);
        let answered = match asked.pieces.as_slice() {
            [] => window.has_ended(),
            pieces => !pieces.iter().any(|piece| window.misses(piece)),
        };
        if !impatient && !answered {
            return Step::Wait(patience.map_or(left, |p| p.saturating_sub(silence).min(left)));
        }
        asked.rounds += usize::from(impatient);
        asked.since = now;
        asked.pieces = window.missing(PIECES);
        Step::Ask(asked.pieces.clone())
    }
}
