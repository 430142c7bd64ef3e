//! The store, as far as the API reaches it.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

use super::App;
use super::problem::{Body, Failed};
use crate::model::{BackupMade, BackupRequest, Problem};

/// Longest name of a backup.
const MAX_NAME: usize = 100;

/// Copies the store while it is in use.
///
/// Into the folder `backups` of the store only: who may ask need not be who owns the daemon's files.
#[utoipa::path(post, path = "/store/backup", tag = "store", request_body = BackupRequest,
    responses((status = 200, body = BackupMade), (status = 400, body = Problem),
        (status = 409, description = "There is one of that name", body = Problem),
        (status = 500, body = Problem)))]
pub(super) async fn backup(
    State(app): State<Arc<App>>,
    Body(wanted): Body<BackupRequest>,
) -> Result<Json<BackupMade>, Failed> {
    if !is_plain_name(&wanted.to) {
        return Err(Failed::new(
            StatusCode::BAD_REQUEST,
            "name",
            "`to` is a name in the store's folder `backups`: letters, digits, `-`, `_` and `.`, not first",
        ));
    }
    let path = app.backups.join(&wanted.to);
    if path.exists() {
        return Err(Failed::new(
            StatusCode::CONFLICT,
            "exists",
            format!("there is a backup {} already", wanted.to),
        ));
    }
    app.backend.backup(path.clone()).await?;
    let path = path.display().to_string();
    Ok(Json(BackupMade { path }))
}

fn is_plain_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.');
    (1..=MAX_NAME).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_backup_stays_in_its_folder() {
        for good in ["before-update", "2026-11-22.db", "a"] {
            assert!(is_plain_name(good), "{good}");
        }
        for bad in [
            "",
            ".",
            "..",
            "../a",
            "/etc/passwd",
            "a/b",
            "a\\b",
            "C:a",
            "a\0",
            "ä",
            ".hidden",
        ] {
            assert!(!is_plain_name(bad), "{bad}");
        }
        assert!(!is_plain_name(&"a".repeat(101)));
    }
}
