//! Reported failures: a server that stalls, one that lost its disk, a window that no worker can identify.

use async_nats::HeaderMap;

use super::robust::assert_whole;
use super::server::Server;
use super::site::{PATIENCE, Site, Worker, fleet, heat, init, status, until};

/// Returns the number of windows of the site's store in a state; `None` while its daemon does not answer.
fn windows(site: &Site, state: &str) -> Option<u64> {
    site.fleet()?["states"][state].as_u64()
}

#[test]
fn an_edge_learns_by_itself_while_its_server_stalls() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::simulated("lab", 1);
    let hob = site.hobs[0].clone();
    let worker = Worker::start(site.path(), &url, "w", &["--threads", "1"]);
    site.start(&url);
    until("results of the worker", PATIENCE, || {
        let trusted = || status(&url).is_some_and(|s| s["edges"][0]["trusts_fleet"] == true);
        site.is_idle(&hob) && {
            heat(site.path(), &hob, "1500");
            site.results().len() >= 5 && trusted()
        }
    });
    // Connections stay, and nothing is answered.
    server.freeze();
    // Answers that came before may still be read. They are counted after the results.
    until("results of the edge itself", PATIENCE, || {
        heat(site.path(), &hob, "1200");
        let results = site.results().len() as u64;
        windows(&site, "answered").is_some_and(|answered| results > answered + 3)
    });
    until("it says that the server does not answer", PATIENCE, || {
        site.fleet()
            .is_some_and(|report| report["connected"] == false)
    });
    server.thaw();
    until("every window in its last state", PATIENCE, || {
        site.assert_runs();
        let last = ["answered", "learned_here", "not_for_fleet"];
        let counts = last.map(|state| windows(&site, state));
        counts.into_iter().sum::<Option<u64>>() == Some(site.stored())
    });
    let report = site.fleet().expect("it answers");
    let state = |name: &str| report["states"][name].as_u64().expect("a count");
    // What it learned of a window that had been sent counts as answered by now.
    assert!(state("answered") >= 5, "{report}");
    assert_eq!(state("no_samples") + state("dead"), 0, "{report}");
    drop(worker);
}

#[test]
fn a_server_that_lost_its_disk_gets_everything_again() {
    let mut server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::new("lab", 2);
    site.fill(15);
    site.start(&url);
    until("all windows sent", PATIENCE, || {
        windows(&site, "sent") == Some(15)
    });
    server.kill9();
    std::fs::remove_dir_all(server.folder().join("store")).expect("its disk");
    server.restart();
    // The streams are missing: failures are counted, and logged once.
    until("failures are counted", PATIENCE, || {
        site.fleet().is_some_and(|report| {
            let why = report["why"].as_str().unwrap_or_default();
            why.contains("ihd-fleet init") && why.contains(" times)")
        })
    });
    let log = site.log();
    let mut warnings: Vec<&str> = log
        .lines()
        .filter_map(|line| line.split_once(" WARN ").map(|(_, text)| text))
        .collect();
    let all = warnings.len();
    warnings.sort_unstable();
    warnings.dedup();
    assert_eq!(warnings.len(), all, "logged twice:\n{log}");
    init(&url, &[]);
    let _worker = Worker::start(site.path(), &url, "w", &["--threads", "2"]);
    assert_whole(&url, &mut site);
    let log = site.log();
    assert!(log.contains("lost what it had"), "{log}");
}

#[test]
fn an_edge_hears_of_a_window_that_nobody_can_identify_and_of_its_result_after_all() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::new("lab", 1);
    site.fill(3);
    let (hob, boot, seq) = site.windows.first().expect("windows").clone();
    // The first as a worker of another version sees it: unreadable, with a message id.
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    runtime.block_on(async {
        let client = async_nats::connect(&url).await.expect("the server");
        let context = async_nats::jetstream::new(client);
        let mut headers = HeaderMap::new();
        headers.insert(
            "Nats-Msg-Id",
            format!("{hob}-{boot}-{seq}-0123456789abcdef"),
        );
        let subject = ihd_fleet::names::window(&hob);
        let sent = context.publish_with_headers(subject, headers, "not a window".into());
        sent.await.expect("sent").await.expect("acknowledged");
    });
    let mut worker = Worker::start(site.path(), &url, "old", &["--threads", "1"]);
    until("it is given up", PATIENCE, || {
        status(&url).is_some_and(|s| s["dead"] == 1 && s["backlog"] == 0)
    });
    worker.kill();
    site.start(&url);
    until("the edge hears of it", PATIENCE, || {
        windows(&site, "dead") == Some(1)
    });
    assert_eq!(windows(&site, "sent"), Some(2));
    assert!(site.log().contains("unpacked"), "{}", site.log());
    let _worker = Worker::start(site.path(), &url, "new", &["--threads", "1"]);
    until("its result after all", PATIENCE, || {
        windows(&site, "answered") == Some(3)
    });
    assert_eq!(windows(&site, "dead"), Some(0));
    assert_eq!(site.results(), site.windows);
    let (text, code) = fleet(&url, &["status", "dead", "--delete"]);
    assert_eq!(code, 0, "{text}");
    let (text, code) = fleet(&url, &["status", "--check"]);
    assert_eq!(code, 0, "{text}");
    site.stop();
}
