//! Schedule of the requests for missing pieces of a window.
//!
//! One lost frame of about seventy must not cost the window. Missing pieces are requested, a few at a time, once the window's end
//! has come or its messages have stopped; the device keeps the window meanwhile. After the last request the window waits for late
//! frames (a link that stalls loses nothing), until a later window has ended or the device reports that it is gone.

use std::time::Duration;

use ihd_shared::wire::messages::ResendWindow;

use super::assembler::UnfinishedWindow;

/// Pieces in one batch of requests: half of what the device's answer queue and the host's buffer have room for.
pub const PIECES_PER_BATCH: usize = 4;

/// Silence before each batch of requests. The longest is far below the time for which a device keeps a window.
const REQUEST_DELAYS: [Duration; 6] = [
    Duration::from_millis(30),
    Duration::from_millis(30),
    Duration::from_millis(60),
    Duration::from_millis(100),
    Duration::from_millis(100),
    Duration::from_millis(100),
];

/// Shortest silence before a request while the window's end has not come: its messages may still be on their way.
const PATIENCE_WITHIN: Duration = Duration::from_millis(100);

/// Silence after which a window is rejected.
const GIVE_UP: Duration = Duration::from_secs(10);

/// Next action for the window under way.
#[derive(Debug, PartialEq)]
pub enum ResendStep {
    /// Nothing to do for this time.
    Wait(Duration),
    /// Send these requests.
    Ask(Vec<ResendWindow>),
    /// Reject the window of this number.
    GiveUp(u32),
}

/// State of the requests for the window under way.
#[derive(Default)]
pub struct Resend {
    window: Option<ResendRounds>,
    /// Recent longest time between two messages of a window: a slow link needs longer waits.
    spacing: Duration,
}

struct ResendRounds {
    seq: u32,
    progress: u32,
    heard: u32,
    /// Time of its last message.
    heard_at: Duration,
    /// Time of its last new piece.
    moved: Duration,
    /// Time of its last message or of the last batch of requests.
    since: Duration,
    /// Batches of requests since the last new piece.
    rounds: usize,
    pieces: Vec<ResendWindow>,
}

impl Resend {
    /// Returns the next action at time `now`.
    pub fn step(&mut self, now: Duration, window: Option<&UnfinishedWindow<'_>>) -> ResendStep {
        let Some(window) = window else {
            self.window = None;
            return ResendStep::Wait(Duration::MAX);
        };
        let asked = self.listen(now, window);
        if now.saturating_sub(asked.moved) >= GIVE_UP {
            return ResendStep::GiveUp(asked.seq);
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
            return ResendStep::Wait(
                patience.map_or(left, |p| p.saturating_sub(silence).min(left)),
            );
        }
        let pieces = window.missing(PIECES_PER_BATCH);
        if let Some(asked) = &mut self.window {
            asked.rounds += usize::from(impatient);
            asked.since = now;
            asked.pieces.clone_from(&pieces);
        }
        ResendStep::Ask(pieces)
    }

    /// Updates the state with what has come since the last step.
    fn listen(&mut self, now: Duration, window: &UnfinishedWindow<'_>) -> &ResendRounds {
        let known = self.window.take().filter(|asked| asked.seq == window.seq());
        let mut asked = known.unwrap_or_else(|| ResendRounds {
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

    /// Silence before the next batch; `None` if there is none left.
    fn patience(&self, rounds: usize, has_ended: bool) -> Option<Duration> {
        let least = if has_ended {
            Duration::ZERO
        } else {
            PATIENCE_WITHIN
        };
        let patience = REQUEST_DELAYS.get(rounds)?;
        Some((*patience).max(2 * self.spacing).max(least))
    }
}
