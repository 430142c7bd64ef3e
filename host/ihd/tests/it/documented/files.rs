//! Files that the documents name and that no documented call before has written: the reader's own captures.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use super::desk::{Desk, ROOT};
use crate::log;

/// The coil's voltage and current with probes that are 50 ns apart.
const CAPTURE: &str = "load=behavioural,rate=10M,skew=50n";

/// The same bench without a pot, at two frequencies.
const EMPTY: &str = "pot=none,skew=50n,fsw=80k,at=5ms:fsw=50k,rate=10M,load=behavioural";

/// Makes a file of this name, if it is one that a reader brings.
pub fn make(desk: &Desk, name: &str) {
    let folder = desk.folder();
    match name {
        "scope.csv" => captured(desk, CAPTURE, name),
        "empty.csv" => captured(desk, EMPTY, name),
        "coil_v.wfm" => copy(
            "tests/fixtures/formats/tek_wfm3le_v.wfm",
            &folder.join(name),
        ),
        "coil_i.wfm" => copy(
            "tests/fixtures/formats/tek_wfm3le_i.wfm",
            &folder.join(name),
        ),
        "coil_v.csv" => table(desk, name, "time_s,v_V\n", |t, v, _| format!("{t},{v}")),
        "coil_i.csv" => table(desk, name, "time_s,i_A\n", |t, _, i| format!("{t},{i}")),
        // Through probes of 100 and 10, the current's the wrong way round.
        "four.csv" => table(desk, name, "TIME,CH1,CH2,CH3,CH4\n", |t, v, i| {
            format!("{t},{},0,{},0", v / 100.0, -i / 10.0)
        }),
        "table.csv" => table(desk, name, "", |t, v, i| format!("{t},{},0,{v}", i * 1e3)),
        "board.elf" => log::image(folder),
        _ if name.starts_with("tests/") => copy(name, &folder.join(name)),
        _ => {}
    }
}

/// Copies a file of the checkout.
fn copy(from: &str, to: &Path) {
    fs::create_dir_all(to.parent().expect("a folder")).unwrap();
    fs::copy(Path::new(ROOT).join(from), to).unwrap_or_else(|why| panic!("{from}: {why}"));
}

/// A simulated capture as a table.
fn captured(desk: &Desk, settings: &str, name: &str) {
    desk.must(&["simulate", "--set", settings, "--out", "simulated.mcap"]);
    desk.must(&["convert", "simulated.mcap", "--out", name]);
}

/// The capture of `scope.csv` in other columns.
fn table(desk: &Desk, name: &str, heading: &str, line: impl Fn(f64, f64, f64) -> String) {
    let scope = desk.folder().join("scope.csv");
    if !scope.exists() {
        make(desk, "scope.csv");
    }
    let mut text = heading.to_owned();
    for row in fs::read_to_string(scope).unwrap().lines().skip(1) {
        let mut numbers = row.split(',').map(|n| n.parse().expect("a number"));
        let mut next = || numbers.next().expect("a column");
        writeln!(text, "{}", line(next(), next(), next())).unwrap();
    }
    fs::write(desk.folder().join(name), text).unwrap();
}
