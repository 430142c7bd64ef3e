//! Killed, cut off, filled up: as many results as windows, none lost, none twice.

use std::time::{Duration, Instant};

use super::chance::Chance;
use super::cut::Cut;
use super::server::Server;
use super::site::{PATIENCE, Site, Worker, fleet, init, status, until};

fn setting(name: &str, default: u64) -> u64 {
    let set = std::env::var(name).ok();
    set.map_or(default, |text| text.parse().expect("a number"))
}

/// Asserts that every window has one result in the fleet and one in its edge's store, and nothing is left over.
pub(super) fn assert_whole(url: &str, site: &mut Site) {
    until("every result in the edge's store", PATIENCE, || {
        site.assert_runs();
        site.results().len() >= site.windows.len()
    });
    assert_eq!(site.results(), site.windows);
    let count = site.windows.len() as u64;
    until("nothing left in the fleet", PATIENCE, || {
        status(url).is_some_and(|s| s["backlog"] == 0 && s["results"] == count)
    });
    let status = status(url).expect("the server answers");
    assert_eq!(status["dead"], 0, "{status}");
    site.stop();
    let reader = ihd_store::Store::open(&site.store(), &ihd_store::StoreOptions::default());
    let due = reader
        .expect("the store")
        .store
        .count_due()
        .expect("a count");
    assert_eq!(
        due, 0,
        "windows that the edge believes the fleet has not got"
    );
}

#[test]
fn whoever_is_killed_as_many_results_as_windows() {
    let kills = setting("IHD_FLEET_KILLS", 1);
    let windows = 40 * kills as usize;
    let mut server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::new("lab", 3);
    site.fill(windows);
    site.start(&url);
    let mut workers: Vec<_> = (0..2)
        .map(|k| Worker::start(site.path(), &url, &format!("w{k}"), &["--threads", "1"]))
        .collect();
    let mut chance = Chance::new(20);
    let mut killed = [0; 3];
    while killed.iter().any(|k| *k < kills) {
        let pause_ms = 100 + chance.next() % 500;
        std::thread::sleep(Duration::from_millis(pause_ms));
        let who = (chance.next() % 3) as usize;
        if killed[who] == kills {
            continue;
        }
        killed[who] += 1;
        match who {
            0 => {
                let k = (chance.next() % 2) as usize;
                workers[k].kill();
                let name = format!("w{k}-{}", killed[0]);
                workers[k] = Worker::start(site.path(), &url, &name, &["--threads", "1"]);
            }
            1 => {
                site.kill();
                site.start(&url);
            }
            _ => {
                server.kill9();
                std::thread::sleep(Duration::from_millis(chance.next() % 1_000));
                server.restart();
            }
        }
        // A worker that starts while the server is down ends; a service manager would restart it.
        for (k, worker) in workers.iter_mut().enumerate() {
            if worker.has_ended() {
                let name = format!("w{k}-again-{}", killed.iter().sum::<u64>());
                *worker = Worker::start(site.path(), &url, &name, &["--threads", "1"]);
            }
        }
    }
    let began = Instant::now();
    assert_whole(&url, &mut site);
    println!(
        "{} windows; worker, edge and server killed {kills} times each; whole {:.0} s after the last",
        site.windows.len(),
        began.elapsed().as_secs_f64()
    );
}

#[test]
fn a_partition_loses_nothing_and_the_edge_goes_on_at_length() {
    let seconds = setting("IHD_FLEET_PARTITION_S", 2);
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let cable = Cut::start(server.address()).expect("a proxy");
    let mut site = Site::new("far", 2);
    site.fill(60);
    let worker = Worker::start(site.path(), &url, "w", &["--threads", "1"]);
    site.start(&cable.url());
    until("some results", PATIENCE, || site.results().len() > 10);
    cable.partition();
    std::thread::sleep(Duration::from_secs(seconds));
    site.assert_runs();
    cable.heal();
    let took = Instant::now();
    assert_whole(&url, &mut site);
    println!(
        "partition of {seconds} s: whole {:.0} s after it",
        took.elapsed().as_secs_f64()
    );
    drop(worker);
}

#[test]
fn a_server_that_is_full_is_waited_for() {
    let server = Server::start("");
    let url = server.url();
    // Room for some ten windows.
    init(&url, &["--windows-bytes", "400000"]);
    let mut site = Site::new("full", 2);
    site.fill(20);
    site.start(&url);
    let stuck = |s: &serde_json::Value| s["windows"].as_u64().is_some_and(|n| n >= 5);
    until("a full queue", PATIENCE, || {
        status(&url).is_some_and(|s| stuck(&s))
    });
    until("the edge says so", PATIENCE, || {
        site.log().contains("maximum bytes")
    });
    let full = status(&url).expect("it answers");
    assert!(full["windows"].as_u64() < Some(20), "{full}");
    let (text, code) = fleet(&url, &["status", "--check"]);
    assert_eq!(code, 7, "no worker for a backlog: {text}");
    let _worker = Worker::start(site.path(), &url, "late", &["--threads", "2"]);
    assert_whole(&url, &mut site);
}

#[test]
fn what_nobody_can_identify_is_given_up_and_comes_back() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    runtime.block_on(async {
        let client = async_nats::connect(&url).await.expect("the server");
        let context = async_nats::jetstream::new(client);
        for (hob, payload) in [("a", &b"garbage"[..]), ("b", &[])] {
            let subject = format!("ihd.v2.{hob}.window");
            let sent = context.publish(subject, payload.to_vec().into()).await;
            sent.expect("sent").await.expect("acknowledged");
        }
    });
    let folder = tempfile::tempdir().expect("a folder");
    let mut worker = Worker::start(folder.path(), &url, "w", &["--threads", "1"]);
    let dead = |count: u64| {
        until("the dead", PATIENCE, || {
            status(&url).is_some_and(|s| s["dead"] == count && s["backlog"] == 0)
        })
    };
    dead(2);
    let (text, code) = fleet(&url, &["status", "dead"]);
    assert!(code == 0 && text.contains("unpacked"), "{text}");
    let (text, code) = fleet(&url, &["status", "--check"]);
    assert!(code == 7 && text.contains("given up"), "{text}");
    worker.kill();
    let (text, _) = fleet(&url, &["retry", "--hob", "a"]);
    assert!(text.contains("1 back"), "{text}");
    let now = status(&url).expect("it answers");
    assert_eq!(
        (&now["backlog"], &now["dead"]),
        (&1.into(), &1.into()),
        "{now}"
    );
    let (text, _) = fleet(&url, &["status", "backlog"]);
    assert!(text.contains('a') && !text.contains("nothing"), "{text}");
    let _worker = Worker::start(folder.path(), &url, "again", &["--threads", "1"]);
    dead(2);
    let (text, _) = fleet(&url, &["status", "dead", "--delete"]);
    assert!(text.contains("2 deleted"), "{text}");
    dead(0);
}
