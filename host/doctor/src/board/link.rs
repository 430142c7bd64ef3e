//! Checks of the link's rate and latency, and of the processor's load.

use std::time::Duration;

use ihd_link::{Client, LinkError, LinkTest};
use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::messages::{LinkTested, Utilisation};

use crate::check_session::CheckSession;
use crate::{Check, Measurement};

/// Number of requests timed.
const QUESTIONS: usize = 100;

/// Limit of the latency in milliseconds: a later answer could be taken for that of the next request.
const P99_MS: f64 = 50.0;
const P50_MS: f64 = 10.0;

/// Number of frames each way: a second on the slowest link.
const FRAMES: u16 = 100;

/// Required rates in kB/s. From the device: a window of 57 kB every 1.5 s (its serial port carries up to 92). To the device: a
/// lookup.
const FROM_DEVICE_KB_S: f64 = 40.0;
const TO_DEVICE_KB_S: f64 = 5.0;

/// Shortest time from which a rate is computed: in process no time passes while bytes are sent.
const MIN_RATE_TIME: Duration = Duration::from_millis(10);

/// Limit of the time between two feedings of the watchdog: half of the 60 ms that it allows.
const MAX_GAP_MS: f64 = 30.0;

/// Limit of the processor's load by a block of samples in percent: the budget of docs/board.md.
const WORST_PCT: f64 = 80.0;

const CABLE: &str = "Another cable, no hub, a shorter way; over a serial port the ST-LINK's firmware. docs/protocol.md says what a frame loses";

/// Examines the controller's load and the link.
pub(super) fn examine(session: &mut CheckSession<'_>) {
    if let Some(used) = session.check_answer("processor", Client::utilisation) {
        session.add(processor(&used));
    }
    if let Some(waits) = session.check_answer("latency", answer_times) {
        session.add(latency(waits));
    }
    match session.check_answer("link_to_device", run_test) {
        Some(test) => {
            session.add(to_device(&test));
            session.add(from_device(&test));
        }
        None => session.add(Check::not_tested(
            "link_from_device",
            "the link was not tested",
        )),
    }
}

/// Measures the times of a hundred answers on the transport's clock.
fn answer_times(client: &mut Client) -> Result<Vec<Duration>, LinkError> {
    (0..QUESTIONS)
        .map(|_| {
            let begin = client.clock();
            client.status()?;
            Ok(client.clock().saturating_sub(begin))
        })
        .collect()
}

/// Checks the median and the 99th percentile.
fn latency(mut waits: Vec<Duration>) -> Check {
    waits.sort();
    let at = |share: f64| {
        let k = (share * waits.len() as f64).ceil() as usize;
        let wait = waits.get(k.saturating_sub(1)).copied();
        wait.map_or(f64::NAN, |wait| wait.as_secs_f64() * 1e3)
    };
    let (p50, p99) = (at(0.5), at(0.99));
    Check::measured(
        "latency",
        format!(
            "p50 {p50:.2} ms, p99 {p99:.2} ms of {} answers",
            waits.len()
        ),
        vec![
            Measurement::at_most("p50", p50, "ms", P50_MS),
            Measurement::at_most("p99", p99, "ms", P99_MS),
        ],
        CABLE,
    )
}

/// Runs the link test in both directions.
fn run_test(client: &mut Client) -> Result<LinkTest, LinkError> {
    client.test_link(FRAMES, CHUNK_BYTES as u16)
}

/// Checks the direction to the device.
fn to_device(test: &LinkTest) -> Check {
    direction(
        "link_to_device",
        &test.to_device,
        test.to_device_took,
        TO_DEVICE_KB_S,
    )
}

/// Checks the direction from the device.
fn from_device(test: &LinkTest) -> Check {
    direction(
        "link_from_device",
        &test.from_device,
        test.from_device_took,
        FROM_DEVICE_KB_S,
    )
}

fn direction(name: &'static str, tested: &LinkTested, took: Duration, least_kb_s: f64) -> Check {
    let kb_s = f64::from(tested.bytes) / took.max(MIN_RATE_TIME).as_secs_f64() * 1e-3;
    let sent = f64::from(FRAMES);
    let evidence = vec![
        Measurement::at_least("rate", kb_s, "kB/s", least_kb_s),
        Measurement::between("frames", tested.frames.into(), "", sent, sent),
        Measurement::at_most("lost", tested.lost.into(), "", 0.0),
        Measurement::at_most("bad", tested.bad.into(), "", 0.0),
    ];
    let at_least = if took < MIN_RATE_TIME {
        "at least "
    } else {
        ""
    };
    let finding = format!("{at_least}{kb_s:.0} kB/s, none of {FRAMES} frames lost or damaged");
    Check::measured(name, finding, evidence, CABLE)
}

/// Checks the processor's load.
fn processor(used: &Utilisation) -> Check {
    const NAME: &str = "processor";
    let gap_ms = f64::from(used.longest_gap_us) * 1e-3;
    if used.blocks == 0 {
        return Check::not_tested(NAME, "the device does not measure it");
    }
    let (mean, worst) = (
        f64::from(used.mean_permille) / 10.0,
        f64::from(used.worst_permille) / 10.0,
    );
    Check::measured(
        NAME,
        format!("a block of samples takes {mean:.1} % on average, {worst:.1} % at worst"),
        vec![
            Measurement::informative("mean", mean, "%"),
            Measurement::at_most("worst", worst, "%", WORST_PCT),
            Measurement::at_most("longest gap", gap_ms, "ms", MAX_GAP_MS),
        ],
        "Report it with ihd log's output: samples are lost next",
    )
}
