//! Rates at which a device may send unasked; what exceeds them is dropped by its id, before it is checked, decoded or copied.
//!
//! A hob sends a half-cycle 100 to 120 times a second, and a window of every twentieth. The limit is twice that, so that a simulated hob
//! may be twice as fast; what a link held back comes in one piece and fits, too. Answers are not limited while a request waits for one.

use std::time::Duration;

use ihd_shared::window::{
    CHUNK_BYTES, MAX_PAIRS, MAX_TRAJECTORY, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES,
};
use ihd_shared::wire::messages::{
    FaultEvent, Log, Message, Telemetry, TrajectoryChunk, WindowChunk, WindowEnd, WindowStart,
};

/// Half-cycles, faults and pieces of the log a second; as many answers for which no request waits.
const NUMBERS_A_SECOND: f64 = 240.0;

/// Windows a second.
const WINDOWS_A_SECOND: f64 = 12.0;

/// Burst that may arrive at once, in seconds of these rates.
const AT_ONCE_S: f64 = 2.0;

/// Messages of the longest window, each sent twice.
const PIECES: usize =
    2 * (2 + (MAX_PAIRS * PAIR_BYTES + MAX_TRAJECTORY * TRAJECTORY_ENTRY_BYTES) / CHUNK_BYTES + 2);

/// So many a second, on a clock that is told.
#[derive(Debug)]
struct Bucket {
    a_second: f64,
    left: f64,
    at: Duration,
}

impl Bucket {
    fn new(a_second: f64, now: Duration) -> Self {
        Self {
            a_second,
            left: AT_ONCE_S * a_second,
            at: now,
        }
    }

    fn takes(&mut self, now: Duration) -> bool {
        let passed = now.saturating_sub(self.at);
        self.at = now;
        let filled = self.left + self.a_second * passed.as_secs_f64();
        self.left = filled.min(AT_ONCE_S * self.a_second);
        let takes = self.left >= 1.0;
        if takes {
            self.left -= 1.0;
        }
        takes
    }
}

/// The limit of one device.
#[derive(Debug)]
pub(super) struct Flood {
    numbers: Bucket,
    /// Answers for which no request waits, and all else: late ones, and hellos.
    others: Bucket,
    windows: Bucket,
    /// Messages that may still come of the window that began last; none where it was beyond the limit.
    pieces: usize,
}

impl Flood {
    /// A limit from now on, on the transport's clock.
    pub(super) fn new(now: Duration) -> Self {
        Self {
            numbers: Bucket::new(NUMBERS_A_SECOND, now),
            others: Bucket::new(NUMBERS_A_SECOND, now),
            windows: Bucket::new(WINDOWS_A_SECOND, now),
            pieces: PIECES,
        }
    }

    /// Returns `true` if a frame of this id is one that a hob may send now; `is_awaited` is `true` while a request waits for its answer.
    pub(super) fn takes(&mut self, id: u8, is_awaited: bool, now: Duration) -> bool {
        match id {
            Telemetry::ID | FaultEvent::ID | Log::ID => self.numbers.takes(now),
            WindowStart::ID => {
                let takes = self.windows.takes(now);
                self.pieces = if takes { PIECES } else { 0 };
                takes
            }
            WindowChunk::ID | TrajectoryChunk::ID | WindowEnd::ID => {
                let takes = self.pieces > 0;
                self.pieces = self.pieces.saturating_sub(1);
                takes
            }
            _ => is_awaited || self.others.takes(now),
        }
    }
}

#[cfg(test)]
mod tests {
    use ihd_shared::wire::messages::Reply;

    use super::*;

    /// Frames of this id that are taken of so many a second, for so long.
    fn taken(flood: &mut Flood, id: u8, a_second: u32, seconds: u32) -> u32 {
        let at = |k| Duration::from_secs(1) * k / a_second;
        let frames = (0..a_second * seconds).filter(|&k| flood.takes(id, false, at(k)));
        frames.count() as u32
    }

    #[test]
    fn a_hob_of_60_hz_sends_all_that_it_has() {
        let mut flood = Flood::new(Duration::ZERO);
        assert_eq!(taken(&mut flood, Telemetry::ID, 120, 3_600), 120 * 3_600);
        assert_eq!(taken(&mut flood, WindowStart::ID, 6, 3_600), 6 * 3_600);
    }

    #[test]
    fn of_a_flood_twice_of_what_a_hob_sends_is_taken() {
        let mut flood = Flood::new(Duration::ZERO);
        let numbers = taken(&mut flood, Telemetry::ID, 4_000, 100);
        assert!((24_000..=24_480).contains(&numbers), "{numbers}");
        let mut flood = Flood::new(Duration::ZERO);
        let windows = taken(&mut flood, WindowStart::ID, 200, 100);
        assert!((1_200..=1_224).contains(&windows), "{windows}");
    }

    #[test]
    fn a_second_that_a_link_held_back_is_taken_whole() {
        let mut flood = Flood::new(Duration::ZERO);
        let at = Duration::from_secs(60);
        assert!((0..120).all(|_| flood.takes(Telemetry::ID, false, at)));
        assert!((0..6).all(|_| flood.takes(WindowStart::ID, false, at)));
    }

    #[test]
    fn no_piece_of_a_window_beyond_the_limit_is_taken() {
        let mut flood = Flood::new(Duration::ZERO);
        let now = Duration::ZERO;
        while flood.takes(WindowStart::ID, false, now) {
            assert!(flood.takes(WindowChunk::ID, false, now));
        }
        for id in [WindowChunk::ID, TrajectoryChunk::ID, WindowEnd::ID] {
            assert!(!flood.takes(id, false, now));
        }
    }

    #[test]
    fn answers_are_limited_unless_a_request_waits() {
        let mut flood = Flood::new(Duration::ZERO);
        let answers = taken(&mut flood, Reply::ID, 4_000, 100);
        assert!((24_000..=24_480).contains(&answers), "{answers}");
        let now = Duration::from_secs(100);
        assert!((0..4_000).all(|_| flood.takes(Reply::ID, true, now)));
    }

    #[test]
    fn a_window_without_end_ends() {
        let mut flood = Flood::new(Duration::ZERO);
        assert!(flood.takes(WindowStart::ID, false, Duration::ZERO));
        let pieces = taken(&mut flood, WindowChunk::ID, 100_000, 10);
        assert!(pieces as usize == PIECES, "{pieces}");
    }
}
