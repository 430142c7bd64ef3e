//! Workers: some answer correctly, some falsely, some die during a window, some publish twice.

use std::time::Duration;

use bytes::Bytes;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_daemon::simulation::LOAD;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::sleep;

use super::line::SimulatedConnection;
use super::server::StreamEntry;
use crate::dead_letters;
use crate::jetstream::MAX_DELIVERIES;
use crate::names;
use crate::stream_message::{Outgoing, PublishFailure};
use crate::wire::{AnswerMessage, WindowMessage};

/// Period of polling the queue.
const POLL_PERIOD: Duration = Duration::from_millis(200);

/// Windows for each poll.
const WINDOWS_PER_POLL: usize = 8;

/// Prefix of the names of workers with false answers, and the least relative error of their R.
pub const LIAR: &str = "liar";
const MIN_LIE: f64 = 0.005;

/// Processes windows until the daemon's life ends.
pub async fn work(line: SimulatedConnection, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let are_silent = line.world.may_fail() && rng.random_bool(0.1);
    if are_silent {
        line.world.note("no worker answers until all is mended");
    }
    loop {
        sleep(POLL_PERIOD).await;
        if are_silent && line.world.may_fail() {
            continue;
        }
        let now = line.world.now();
        let (given, disk) = {
            let mut disk = line.memory.disk();
            (disk.give_windows(now, WINDOWS_PER_POLL), disk.before)
        };
        for (number, message, times) in given {
            let (line, seed) = (line.clone(), rng.random());
            let place = QueuePosition { disk, number };
            tokio::spawn(deal(line, place, message, times, seed));
        }
    }
}

/// Place of a window in the queue.
#[derive(Clone, Copy)]
struct QueuePosition {
    disk: u32,
    number: u64,
}

async fn deal(
    line: SimulatedConnection,
    place: QueuePosition,
    message: StreamEntry,
    times: u32,
    seed: u64,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let fails = line.world.may_fail();
    let Ok(window) = WindowMessage::from_bytes(&message.payload) else {
        return line.world.note_broken("a window cannot be read".to_owned());
    };
    sleep(Duration::from_millis(rng.random_range(50..500))).await;
    let of = format!("{} {}", window.boot, window.window.seq);
    line.world
        .note(&format!("a worker has {of} of {}", window.hob));
    if fails && rng.random_bool(0.1) {
        return line.world.note(&format!("a worker dies over {of}"));
    }
    if i64::from(times) > MAX_DELIVERIES || fails && rng.random_bool(0.05) {
        line.world.note(&format!("{of} is given up"));
        return bury(&line, place, &message, &window);
    }
    if fails && rng.random_bool(0.1) {
        // Longer than the acknowledgement time-out.
        sleep(Duration::from_millis(rng.random_range(1_000..45_000))).await;
    }
    if fails && rng.random_bool(0.1) {
        let unasked = window.window.seq + 100_000;
        publish(&line, answer(&mut rng, &window, unasked), Some(0));
    }
    let result = answer(&mut rng, &window, window.window.seq);
    if fails && rng.random_bool(0.1) {
        // A publication without a condition replaces the one before.
        publish(&line, result.clone(), None);
    }
    publish(&line, result, Some(0));
    if fails && rng.random_bool(0.1) {
        // Killed before the acknowledgement.
        return;
    }
    done(&line, place);
}

fn done(line: &SimulatedConnection, place: QueuePosition) {
    let mut disk = line.memory.disk();
    if disk.before == place.disk {
        disk.windows.ack(place.number);
        disk.stream(names::WINDOWS).messages.remove(&place.number);
    }
}

fn publish(line: &SimulatedConnection, (subject, payload): (String, Bytes), after: Option<u64>) {
    let now = line.world.now();
    let published = line.memory.disk().publish(
        now,
        Outgoing {
            subject,
            payload,
            number: None,
            after,
        },
    );
    if let Err(PublishFailure::Other(why)) = published {
        line.world.note_broken(why);
    }
}

fn bury(
    line: &SimulatedConnection,
    place: QueuePosition,
    message: &StreamEntry,
    window: &WindowMessage,
) {
    let subject = names::dead_letter(&window.hob, window.boot, window.window.seq);
    publish(line, (subject.clone(), message.payload.clone()), Some(0));
    let mut disk = line.memory.disk();
    let letters = disk.stream(names::DEAD).messages.values_mut();
    for message in letters.filter(|message| message.subject == subject) {
        message
            .headers
            .insert(dead_letters::WHY, "nobody could identify it");
        message.headers.insert(dead_letters::BY, "worker-1");
    }
    drop(disk);
    done(line, place);
}

/// Returns subject and bytes of an answer: the window's load, none if it shows none, a false one, or unreadable bytes.
fn answer(rng: &mut ChaCha8Rng, window: &WindowMessage, seq: u32) -> (String, Bytes) {
    let subject = names::result(&window.hob, window.boot, seq);
    if rng.random_bool(0.05) {
        return (subject, Bytes::from_static(b"no answer"));
    }
    let shows = window.window.pairs.len() > 61;
    let lies = rng.random_bool(0.4);
    let lie = match rng.random_bool(0.5) {
        true => rng.random_range(MIN_LIE..1.0),
        false => -rng.random_range(MIN_LIE..0.5),
    };
    let stated = |factor: f64| {
        let t_s: Vec<f64> = (0..64).map(|k| 10e-3 / 63.0 * f64::from(k)).collect();
        StatedLoad {
            r_ohm: vec![factor * LOAD.r_ohm; t_s.len()],
            l_h: vec![LOAD.l_h; t_s.len()],
            t_s,
            ..StatedLoad::default()
        }
    };
    let load = match (lies, shows) {
        (true, _) => Ok(stated(1.0 + lie)),
        (false, true) => Ok(stated(1.0)),
        (false, false) => Err("it shows nothing".to_owned()),
    };
    let name = if lies { LIAR } else { "worker" };
    let message = AnswerMessage {
        hob: window.hob.clone(),
        boot: window.boot,
        seq,
        window_at_ms: window.at_ms,
        at_ms: 0,
        answer: WorkerAnswer {
            by: format!("{name}-{}", rng.random_range(0..9)),
            skew_s: None,
            load,
            busy: Duration::from_millis(60),
        },
    };
    let payload = message.to_bytes().expect("an answer that can be packed");
    (subject, payload.into())
}
