//! Measured costs and throughput of a fleet: the tables of docs/fleet.md (`--profile full study`). Server, edge and workers
//! share one machine.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use async_nats::jetstream;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_fleet::MessageIds;
use ihd_fleet::wire::WindowMessage;
use ihd_fleet::worker::{self, WorkerSettings};
use ihd_identify::{IdentifyOptions, Method};
use ihd_link::Window;
use ihd_store::{ResultFilter, StoreReader, StoredCurve};
use ihd_train::NetworkConfig;
use tokio::sync::watch;

use super::process::{Process, processor_s};
use super::server::Server;
use super::site::{Site, Worker, init, status, tape, until};

/// Time-out of one run of the study.
const PATIENCE: Duration = Duration::from_secs(3_000);

/// Duration of the work that [`pretend`] stands for, set by each test: a worker's function has no state.
static PRETENDED_MS: AtomicU64 = AtomicU64::new(0);

/// Takes as long as set, then answers with R(t) and L(t) of the lock-in.
fn pretend(by: String, window: &Window, _: Option<f64>, _: NetworkConfig) -> WorkerAnswer {
    std::thread::sleep(Duration::from_millis(PRETENDED_MS.load(Relaxed)));
    let estimate = ihd_identify::run(
        Method::Lockin,
        &window.segment(),
        &IdentifyOptions::default(),
    );
    let load = estimate.map_err(|e| e.to_string()).map(|estimate| {
        let curve = StoredCurve {
            t_s: estimate.t_s,
            r_ohm: estimate.r_ohm,
            l_h: estimate.l_h,
            ..StoredCurve::default()
        };
        let curve = curve.thinned();
        StatedLoad {
            t_s: curve.t_s,
            r_ohm: curve.r_ohm,
            l_h: curve.l_h,
            ..StatedLoad::default()
        }
    });
    WorkerAnswer {
        by,
        skew_s: None,
        load,
        busy: Duration::ZERO,
    }
}

/// Worker in this process that pretends to work.
struct PretendingWorker {
    stop: watch::Sender<bool>,
    running: Option<JoinHandle<()>>,
}

impl PretendingWorker {
    fn start(url: &str, name: &str, threads: usize, time_ms: u64) -> Self {
        PRETENDED_MS.store(time_ms, Relaxed);
        let (stop, stopped) = watch::channel(false);
        let (url, name) = (url.to_owned(), name.to_owned());
        let run = move || {
            let runtime = tokio::runtime::Runtime::new().expect("threads");
            runtime.block_on(async {
                let client = async_nats::connect(&url).await.expect("the server");
                let settings = WorkerSettings {
                    name,
                    threads,
                    network: NetworkConfig::default(),
                    identify: pretend,
                };
                let working =
                    worker::run(jetstream::new(client), settings, Arc::default(), stopped);
                working.await.expect("a fleet");
            });
        };
        Self {
            stop,
            running: Some(std::thread::spawn(run)),
        }
    }
}

impl Drop for PretendingWorker {
    fn drop(&mut self) {
        let _ = self.stop.send(true);
        if let Some(running) = self.running.take() {
            let _ = running.join();
        }
    }
}

/// Numbers of `ihd-fleet status`, read by this process: a command for each reading would be a part of the measurement.
struct Monitor {
    runtime: tokio::runtime::Runtime,
    context: jetstream::Context,
}

impl Monitor {
    fn at(url: &str) -> Self {
        let runtime = tokio::runtime::Runtime::new().expect("threads");
        let client = runtime
            .block_on(async_nats::connect(url))
            .expect("the server");
        let context = {
            let _within = runtime.enter();
            jetstream::new(client)
        };
        Self { runtime, context }
    }

    /// Returns the number of messages ever and the present bytes of a stream.
    fn stream(&self, name: &str) -> (u64, u64) {
        let state = self.runtime.block_on(async {
            let mut stream = self.context.get_stream(name).await.expect("a stream");
            stream.info().await.expect("its state").state.clone()
        });
        (state.last_sequence, state.bytes)
    }

    fn results(&self) -> u64 {
        self.stream("IHD_RESULTS").0
    }
}

fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let rank = (sorted.len() as f64 * percent / 100.0).ceil() as usize;
    sorted
        .get(rank.saturating_sub(1))
        .copied()
        .unwrap_or(f64::NAN)
}

/// Makes a backlog of `count` windows on a new server, without workers.
fn backlog(count: usize) -> (Server, Site, Monitor) {
    let server = Server::start("");
    let url = server.url();
    init(&url, &["--threads", "64"]);
    let mut site = Site::new("lab", 4);
    site.fill(count);
    site.start(&url);
    let monitor = Monitor::at(&url);
    until("the backlog", PATIENCE, || {
        monitor.stream("IHD_WINDOWS").0 == count as u64
    });
    (server, site, monitor)
}

/// Returns the windows a second of a backlog, from the time at which all workers run.
fn rate<W>(
    server: &Server,
    site: &Site,
    monitor: &Monitor,
    workers: usize,
    start: impl Fn(&str, &str) -> W,
) -> f64 {
    let url = server.url();
    let _workers: Vec<W> = (0..workers)
        .map(|k| start(&url, &format!("w{k}")))
        .collect();
    let total = site.windows.len() as u64;
    until("all at work", PATIENCE, || {
        status(&url).is_some_and(|s| s["workers"].as_array().map(Vec::len) == Some(workers))
    });
    let (first, began) = (monitor.results(), Instant::now());
    until("the end of the backlog", PATIENCE, || {
        monitor.results() == total
    });
    (total - first) as f64 / began.elapsed().as_secs_f64()
}

#[test]
fn windows_a_second_against_workers_at_length() {
    println!("| workers (a thread each) | windows/s | against one |\n|---|---|---|");
    let mut one = f64::NAN;
    for workers in [1, 2, 4] {
        let (server, site, monitor) = backlog(1_500);
        let start =
            |url: &str, name: &str| Worker::start(site.path(), url, name, &["--threads", "1"]);
        let rate = rate(&server, &site, &monitor, workers, start);
        if workers == 1 {
            one = rate;
        }
        println!("| {workers} | {rate:.1} | {:.2} |", rate / one);
    }
    println!(
        "| threads, 200 ms of pretended work each | windows/s | of what is possible |\n|---|---|---|"
    );
    for threads in [1, 2, 4, 8, 16, 32, 64] {
        let (server, site, monitor) = backlog(60 * threads);
        let workers = threads.min(4);
        let start =
            |url: &str, name: &str| PretendingWorker::start(url, name, threads / workers, 200);
        let rate = rate(&server, &site, &monitor, workers, start);
        println!(
            "| {threads} | {rate:.1} | {:.0} % |",
            100.0 * rate * 0.2 / threads as f64
        );
    }
}

#[test]
fn what_a_window_costs_at_length() {
    let count = 1_500;
    let (server, mut site, monitor) = backlog(count);
    let (_, window_bytes) = monitor.stream("IHD_WINDOWS");
    let url = server.url();
    let folder = site.path().to_owned();
    let edge_before = site.processor_s();
    let server_before = processor_s(server.pid());
    let mut command = super::site::ihd_fleet(&folder);
    command.args(["worker", "--url", &url, "--name", "w", "--threads", "1"]);
    command.stderr(std::process::Stdio::null());
    let mut worker = Process::spawn(&mut command).expect("a worker");
    until("its work", PATIENCE, || {
        site.assert_runs();
        site.results().len() == count
    });
    let ms = |seconds: f64| 1e3 * seconds / count as f64;
    let (_, result_bytes) = monitor.stream("IHD_RESULTS");
    println!("| of a window | bytes | processor ms |\n|---|---|---|");
    let raw = 4 * tape().windows[0].pairs.len() + 8 * tape().windows[0].trajectory.len();
    println!("| as the device sends it | {raw} | |");
    println!("| in the queue | {} | |", window_bytes / count as u64);
    println!("| its result | {} | |", result_bytes / count as u64);
    println!("| worker | | {:.1} |", ms(worker.processor_s()));
    println!(
        "| edge, taking the result in | | {:.1} |",
        ms(site.processor_s() - edge_before)
    );
    println!("| edge, sending | | {:.1} |", ms(edge_before));
    println!(
        "| server, result and acknowledgements | | {:.1} |",
        ms(processor_s(server.pid()) - server_before)
    );
    println!("| server, window | | {:.1} |", ms(server_before));
    println!(
        "worker {:.0} MB, edge {:.0} MB",
        1e-6 * worker.rss() as f64,
        1e-6 * site.rss() as f64
    );
}

#[test]
fn from_window_to_lookup_at_length() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::simulated("lab", 1);
    let hob = site.hobs[0].clone();
    let _worker = Worker::start(site.path(), &url, "w", &["--threads", "1"]);
    site.start(&url);
    until("the hob", PATIENCE, || {
        status(&url).is_some_and(|s| s["devices"][0]["state"] == "idle")
    });
    for power in ["700", "1000", "1300", "1600", "2000", "1800", "1100", "900"] {
        site.device(&[&hob, "power", power, "--for", "12"]);
    }
    std::thread::sleep(Duration::from_secs(3));
    let reader = StoreReader::open(&site.store()).expect("the store");
    let filter = ResultFilter {
        limit: Some(u32::MAX),
        ..ResultFilter::default()
    };
    let (mut to_result, mut to_lookup) = (Vec::new(), Vec::new());
    let lookups = reader.lookups().expect("lookups");
    let windows = reader.windows(&Default::default()).expect("windows");
    for result in reader.results(&filter).expect("results") {
        let of = |w: &&ihd_store::WindowRow| (w.boot, w.seq) == (result.boot, result.seq);
        let Some(row) = windows.iter().find(of) else {
            continue;
        };
        to_result.push(1e-3 * (result.at_ms - row.at_ms) as f64);
        // The first lookup stored after the result is the one that it changed.
        let active = lookups
            .iter()
            .map(|l| l.at_ms)
            .filter(|at| *at >= result.at_ms)
            .min();
        if let (true, Some(at_ms)) = (result.changed_lookup, active) {
            to_lookup.push(1e-3 * (at_ms - row.at_ms) as f64);
        }
    }
    println!("| from the window in the store to | count | p50 s | p99 s |\n|---|---|---|---|");
    for (what, times) in [
        ("its result in the store", &mut to_result),
        ("the lookup in use", &mut to_lookup),
    ] {
        times.sort_by(f64::total_cmp);
        println!(
            "| {what} | {} | {:.2} | {:.2} |",
            times.len(),
            percentile(times, 50.0),
            percentile(times, 99.0)
        );
    }
}

#[test]
fn a_backlog_of_an_hour_at_length() {
    // One hob, five windows a second, an hour; identified by 32 threads that pretend to take a tenth of a second, as many machines would.
    let count = 18_000;
    let server = Server::start("");
    let url = server.url();
    init(&url, &["--windows-bytes", "2000000000"]);
    let mut site = Site::new("far", 1);
    site.fill(count);
    let monitor = Monitor::at(&url);
    let _workers: Vec<PretendingWorker> = (0..2)
        .map(|k| PretendingWorker::start(&url, &format!("w{k}"), 16, 100))
        .collect();
    let began = Instant::now();
    site.start(&url);
    let sent = until("the queue", PATIENCE, || {
        monitor.stream("IHD_WINDOWS").0 == count as u64
    });
    until("all results", PATIENCE, || {
        monitor.results() == count as u64
    });
    let identified = began.elapsed();
    until("in the store", PATIENCE, || site.results().len() == count);
    println!(
        "{count} windows: in the queue after {:.0} s, through 32 threads after {:.0} s ({:.1} a second), in the edge's store after {:.0} s",
        sent.as_secs_f64(),
        identified.as_secs_f64(),
        count as f64 / identified.as_secs_f64(),
        began.elapsed().as_secs_f64()
    );
}

#[test]
fn a_thousand_edges_on_one_server_at_length() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &["--windows-bytes", "2000000000"]);
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    println!(
        "| edges | windows/s | acknowledged p50 ms | p99 ms | server's processor | server MB |\n|---|---|---|---|---|---|"
    );
    for edges in [10u32, 100, 1_000] {
        let seconds = 20;
        let before = processor_s(server.pid());
        let began = Instant::now();
        let mut times = runtime.block_on(async {
            let edge = |k: u32| {
                let url = url.clone();
                async move {
                    let client = async_nats::connect(&url).await.expect("a connection");
                    let context = jetstream::new(client);
                    let hob = format!("hob-{k}");
                    let message_ids = MessageIds::new([k as u8; 16]);
                    let mut message = WindowMessage {
                        hob: hob.clone(),
                        boot: k,
                        at_ms: 0,
                        skew_s: None,
                        not_for: Vec::new(),
                        window: tape().windows[0].clone(),
                    };
                    let mut times = Vec::new();
                    // A window every five seconds, each at its own time.
                    tokio::time::sleep(Duration::from_millis(u64::from(k * 37 % 5_000))).await;
                    for seq in 0..seconds / 5 {
                        message.window.seq = seq as u32 + edges;
                        let bytes = message.to_bytes().expect("packed");
                        let publish = jetstream::message::PublishMessage::build()
                            .payload(bytes.into())
                            .message_id(message_ids.window_id(&hob, k, message.window.seq));
                        let asked = Instant::now();
                        let subject = format!("ihd.v2.{hob}.window");
                        let sent = context.send_publish(subject, publish).await.expect("sent");
                        sent.await.expect("acknowledged");
                        times.push(1e3 * asked.elapsed().as_secs_f64());
                        tokio::time::sleep(Duration::from_secs(5)).await;
                    }
                    times
                }
            };
            let tasks: Vec<_> = (0..edges).map(|k| tokio::spawn(edge(k))).collect();
            let mut times = Vec::new();
            for task in tasks {
                times.extend(task.await.expect("an edge"));
            }
            times
        });
        let took = began.elapsed().as_secs_f64();
        times.sort_by(f64::total_cmp);
        let memory = std::fs::read_to_string(format!("/proc/{}/statm", server.pid()));
        let pages = memory
            .ok()
            .and_then(|m| m.split_whitespace().nth(1)?.parse::<f64>().ok());
        println!(
            "| {edges} | {:.0} | {:.1} | {:.1} | {:.0} % | {:.0} |",
            times.len() as f64 / took,
            percentile(&times, 50.0),
            percentile(&times, 99.0),
            100.0 * (processor_s(server.pid()) - before) / took,
            pages.unwrap_or(f64::NAN) * 4_096e-6
        );
    }
}
