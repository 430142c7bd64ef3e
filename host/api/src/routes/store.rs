//! Backup of the store.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use ihd_model::{BackupMade, BackupRequest, Problem};

use super::App;
use crate::problem::{ErrorResponse, JsonBody};

/// Maximum length of the name of a backup, in bytes.
const MAX_NAME: usize = 100;

/// Copies the store while it is in use.
///
/// The copy goes to the folder `backups` of the store only: a client with this right need not own the daemon's files.
#[utoipa::path(post, path = "/store/backup", tag = "store", request_body = BackupRequest,
    responses((status = 200, body = BackupMade), (status = 400, body = Problem),
        (status = 409, description = "There is a backup of that name already", body = Problem),
        (status = 500, body = Problem)))]
pub(super) async fn backup(
    State(app): State<Arc<App>>,
    JsonBody(request): JsonBody<BackupRequest>,
) -> Result<Json<BackupMade>, ErrorResponse> {
    if !is_plain_name(&request.to) {
        return Err(ErrorResponse::new(
            StatusCode::BAD_REQUEST,
            "name",
            "`to` is a name in the store's folder `backups`: letters, digits, `-`, `_` and `.`, not first",
        ));
    }
    let path = app.backups.join(&request.to);
    if path.exists() {
        return Err(ErrorResponse::new(
            StatusCode::CONFLICT,
            "exists",
            format!("there is a backup {} already", request.to),
        ));
    }
    if let Err(error) = std::fs::create_dir_all(&app.backups) {
        tracing::warn!(%error, "the folder for backups cannot be made");
    }
    app.daemon.upkeep().backup(path.clone()).await?;
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
