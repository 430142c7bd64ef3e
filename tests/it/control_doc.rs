//! docs/control.md holds the table of limits that the firmware is built with.

use std::fmt::Write;

use ihd_firmware::limits::{LEVELS, TABLE};

use super::document;

fn table() -> String {
    let mut text = String::from("| limit | value | unit | what for |\n|---|---:|---|---|\n");
    for row in TABLE {
        let doc = row.doc.trim().replace("[`", "`").replace("`]", "`");
        // A `String` takes every line.
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {doc} |",
            row.name, row.value, row.unit
        );
    }
    text
}

fn levels() -> String {
    let mut text = String::from("| level | power, W | off after, min |\n|---|---:|---:|\n");
    for (level, row) in (1..).zip(LEVELS) {
        let _ = writeln!(
            text,
            "| {level} | {} | {} |",
            row.power_w, row.unattended_min
        );
    }
    text
}

#[test]
fn the_document_holds_the_panels_levels() {
    let command = "cargo test -p ihd-tests control_doc";
    document::hold("control.md", "levels", &levels(), command);
}

#[test]
fn the_document_holds_the_limits_of_the_firmware() {
    let command = "cargo test -p ihd-tests control_doc";
    document::hold("control.md", "limits", &table(), command);
}
