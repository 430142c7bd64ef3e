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

/// Silence about a window before each time that its missing pieces are asked for. The longest is well below what a
/// device keeps a window for.
const PATIENCE: [Duration; 6] = [
    Duration::from_millis(30),
    Duration::from_millis(30),
    Duration::from_millis(60),
    Duration::from_millis(100),
    Duration::from_millis(100),
    Duration::from_millis(100),
];

/// The least of it while the window's end has not come: more may come by itself.
const PATIENCE_WITHIN: Duration = Duration::from_millis(100);

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
    /// What lies between two messages of a window lately, at the longest: a slow link needs more patience.
    spacing: Duration,
}

struct Asked {
    seq: u32,
    progress: u32,
    heard: u32,
    /// When its last message came.
    heard_at: Duration,
    /// When the last new piece came.
    moved: Duration,
    /// When a message came, or pieces were asked for, last.
    since: Duration,
    /// Times that silence led to a request, since the last new piece.
    rounds: usize,
    pieces: Vec<ResendWindow>,
}

impl Resend {
    /// The next step, now.
    pub fn step(&mut self, now: Duration, window: Option<&Unfinished<'_>>) -> Step {
        let Some(window) = window else {
            self.window = None;
            return Step::Wait(Duration::MAX);
        };
        let asked = self.listen(now, window);
        if now.saturating_sub(asked.moved) >= GIVE_UP {
            return Step::GiveUp(asked.seq);
        }
        let left = (asked.moved + GIVE_UP).saturating_sub(now);
        let answered = match asked.pieces.as_slice() {
            [] => window.has_ended(),
            pieces => !pieces.iter().any(|piece| window.misses(piece)),
        };
        let silence = now.saturating_sub(asked.since);
        let rounds = asked.rounds;
        let patience = self.patience(rounds, window.has_ended());
        let impatient = patience.is_some_and(|patience| silence >= patience);
        if !impatient && !answered {
            return Step::Wait(patience.map_or(left, |p| p.saturating_sub(silence).min(left)));
        }
        let pieces = window.missing(PIECES);
        if let Some(asked) = &mut self.window {
            asked.rounds += usize::from(impatient);
            asked.since = now;
            asked.pieces.clone_from(&pieces);
        }
        Step::Ask(pieces)
    }

    /// Notes what has come since the last step.
    fn listen(&mut self, now: Duration, window: &Unfinished<'_>) -> &Asked {
        let known = self.window.take().filter(|asked| asked.seq == window.seq());
        let mut asked = known.unwrap_or_else(|| Asked {
            seq: window.seq(),
            progress: window.progress(),
            heard: window.heard(),
            heard_at: now,
            moved: now,
            since: now,
            rounds: 0,
            pieces: Vec::new(),
        });
        if asked.heard != window.heard() {
            let gap = now.saturating_sub(asked.heard_at);
            self.spacing = gap.max(self.spacing * 3 / 4);
            asked.heard = window.heard();
            (asked.heard_at, asked.since) = (now, now);
        }
        if asked.progress != window.progress() {
            asked.progress = window.progress();
            (asked.moved, asked.rounds) = (now, 0);
        }
        self.window.insert(asked)
    }

    /// Silence before the next request; `None` when there is none.
    fn patience(&self, rounds: usize, has_ended: bool) -> Option<Duration> {
        let least = if has_ended {
            Duration::ZERO
        } else {
            PATIENCE_WITHIN
        };
        let patience = PATIENCE.get(rounds)?;
        Some((*patience).max(2 * self.spacing).max(least))
    }
}
