//! docs/control.md holds the table of limits that the firmware is built with.

use std::fmt::Write;
use std::path::Path;

use ihd_firmware::limits::TABLE;

const BEGIN: &str = "<!-- limits: begin -->\n";
const END: &str = "<!-- limits: end -->\n";

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

#[test]
fn the_document_holds_the_limits_of_the_firmware() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/control.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once(BEGIN).expect("a mark where it begins");
    let (_, after) = rest.split_once(END).expect("a mark where it ends");
    let expected = format!("{before}{BEGIN}{}{END}{after}", table());
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, &expected).unwrap();
    } else {
        assert_eq!(text, expected, "run with UPDATE_DOCS=1");
    }
}
