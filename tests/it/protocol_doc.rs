//! docs/protocol.md is what the message table gives.

use std::path::Path;

#[test]
fn the_document_follows_the_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/protocol.md");
    let generated = ihd_link::protocol_doc::markdown();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &generated).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        kept == generated,
        "docs/protocol.md is not what the message table gives: \
         UPDATE_DOCS=1 cargo test -p ihd-tests protocol_doc"
    );
}
