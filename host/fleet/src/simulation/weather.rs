//! Faults of line and server, at random times.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::{Instant, sleep};

use super::line::SimulatedConnection;

/// Longest time in milliseconds until a client detects a cut: three pings without an answer.
const SEEN_WITHIN_MS: u64 = 15_000;

/// Makes faults at random times; connects the edge first, and again after each cut.
pub async fn change(line: SimulatedConnection, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let ms = |rng: &mut ChaCha8Rng, range| Duration::from_millis(rng.random_range(range));
    sleep(ms(&mut rng, 0..2_000)).await;
    line.edge.lock().unwrap().connect();
    {
        let mut weather = line.weather();
        weather.lost = [0.0, 0.0, 0.02, 0.2][rng.random_range(0..4)];
        weather.late = [0.0, 0.0, 0.02, 0.2][rng.random_range(0..4)];
    }
    while line.world.may_fail() {
        sleep(ms(&mut rng, 500..15_000)).await;
        if !line.world.may_fail() {
            break;
        }
        let lasts = ms(&mut rng, 100..60_000);
        let until = Instant::now() + lasts;
        match rng.random_range(0..8) {
            0 | 1 => {
                line.world.note(&format!("the server stalls for {lasts:?}"));
                line.weather().stalled_until = until;
                sleep(lasts).await;
            }
            2 | 3 => {
                let seen = ms(&mut rng, 0..SEEN_WITHIN_MS).min(lasts);
                cut(&line, lasts, seen).await;
            }
            4 => {
                line.world.note("the server restarts");
                let now = line.world.now();
                line.memory.disk().restart(now);
                cut(&line, ms(&mut rng, 100..5_000), Duration::ZERO).await;
            }
            5 => {
                let bare = ms(&mut rng, 0..10_000);
                let text = format!("the server loses its disk, and has streams after {bare:?}");
                line.world.note(&text);
                line.memory.disk().lose();
                line.received().waited_for.clear();
                line.weather().bare_until = Instant::now() + bare;
                if rng.random_bool(0.5) {
                    cut(&line, ms(&mut rng, 100..5_000), Duration::ZERO).await;
                }
            }
            6 => {
                line.world.note(&format!("the queue is full for {lasts:?}"));
                line.weather().full_until = until;
            }
            _ => {}
        }
    }
    line.edge.lock().unwrap().connect();
}

/// Cuts the connection for a time; the client detects it after `seen`.
async fn cut(line: &SimulatedConnection, lasts: Duration, seen: Duration) {
    line.world.note(&format!(
        "the line is cut for {lasts:?}, seen after {seen:?}"
    ));
    line.weather().stalled_until = Instant::now() + lasts;
    sleep(seen).await;
    line.edge.lock().unwrap().disconnect();
    let until = Instant::now() + (lasts - seen);
    while line.is_stalled() && Instant::now() < until {
        sleep(Duration::from_millis(100)).await;
    }
    line.edge.lock().unwrap().connect();
}
