//! An edge's name is one store's: two daemons with one name, a store that moves, a name that is freed.

use super::robust::assert_whole;
use super::server::Server;
use super::site::{PATIENCE, Site, Worker, fleet, init, status, until};

#[test]
fn a_name_is_one_stores_until_it_is_freed() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut first = Site::new("lab", 1);
    first.fill(5);
    first.start(&url);
    until("it has the name", PATIENCE, || {
        status(&url).is_some_and(|s| s["edges"][0]["name"] == "lab")
    });
    let mut second = Site::new("twin", 1);
    second.edge = "lab".to_owned();
    second.fill(5);
    second.start(&url);
    let places = [&first, &second].map(|site| site.store().display().to_string());
    let names_both = |text: &str| places.iter().all(|place| text.contains(place));
    until("the page of the second says why", PATIENCE, || {
        let report = second.fleet().unwrap_or_default();
        report["alarms"][0].as_str().is_some_and(names_both)
    });
    assert!(names_both(&second.log()), "{}", second.log());
    until("so does the operator's", PATIENCE, || {
        let (text, code) = fleet(&url, &["status", "--check"]);
        code == 7 && names_both(&text)
    });
    // The first has its results, and the fleet nothing of the second.
    let worker = Worker::start(first.path(), &url, "w", &["--threads", "1"]);
    assert_whole(&url, &mut first);
    assert!(second.results().is_empty());
    assert_eq!(second.fleet().expect("it answers")["states"]["due"], 5);

    // Its store moves: the name goes with it, from a place that is no more.
    first.move_away();
    first.fill(5);
    first.start(&url);
    until("results at the new place", PATIENCE, || {
        first.assert_runs();
        first.results() == first.windows
    });
    first.stop();

    let (text, code) = fleet(&url, &["init", "--free", "lab"]);
    assert!(code == 0 && text.contains("lab is free"), "{text}");
    until("results of the second", PATIENCE, || {
        second.assert_runs();
        second.results() == second.windows
    });
    until("nothing is amiss", PATIENCE, || {
        let (text, code) = fleet(&url, &["status", "--check"]);
        println!("{text}");
        code == 0
    });
    drop(worker);
}
