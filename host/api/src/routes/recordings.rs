//! Recordings: which there are, and their download as they are or as tables.

use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::UNIX_EPOCH;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE,
    ETAG, IF_RANGE, RANGE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use http_range_header::parse_range_header;
use ihd_daemon::model::RecordingFile;
use ihd_daemon::recording::{Table, TableError, is_plain_name, table};
use serde::Deserialize;
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use super::problem::{Asked, Failed};
use crate::model::Problem;

/// Tables that are made at a time, by the whole process: each keeps a core busy.
static CONVERSIONS: Semaphore = Semaphore::const_new(2);

/// Bytes that are read at a time.
const CHUNK: usize = 1 << 17;

/// Chunks that wait for the socket.
const CHUNKS: usize = 2;

const BYTES: &str = "application/octet-stream";
const CSV: &str = "text/csv; charset=utf-8";

/// The recordings that there are, newest first.
#[utoipa::path(get, path = "/recordings", operation_id = "recordings", tag = "recordings",
    responses((status = 200, body = [RecordingFile])))]
pub(super) async fn all(State(app): State<Arc<App>>) -> Result<Json<Vec<RecordingFile>>, Failed> {
    Ok(Json(app.backend.recordings().await?))
}

/// In which form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Form {
    /// The file itself.
    #[default]
    Mcap,
    /// The samples of all windows, with the window's number.
    Csv,
    /// A line a half-cycle.
    HalfCycles,
    /// Everything as arrays.
    Npz,
}

/// How a recording is wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// `mcap` (the file itself, without a word), `csv` (samples of all windows), `half-cycles` (a line each, CSV) or
    /// `npz` (all of it, for NumPy).
    #[serde(default)]
    #[param(value_type = Option<String>)]
    format: Form,
}

/// A recording. Of one under way what is on disk. The file itself comes in parts, too (`Range`, `If-Range`), so that a broken download
/// goes on.
///
/// Times of tables count from the trigger. CSV has the columns `time_s,v_V,i_A,window`.
#[utoipa::path(get, path = "/recordings/{file}", operation_id = "recording", tag = "recordings",
    params(("file" = String, Path, description = "Name of the recording"), Wanted),
    responses((status = 200, description = "The file", content_type = "application/octet-stream", body = Vec<u8>),
        (status = 206, description = "The part of it that was asked for", content_type = "application/octet-stream", body = Vec<u8>),
        (status = 416, description = "It has no such part", body = Problem),
        (status = 400, body = Problem), (status = 404, body = Problem),
        (status = 409, description = "It holds nothing of that kind, or is damaged", body = Problem),
        (status = 413, description = "It would become too large", body = Problem),
        (status = 503, description = "Two are being converted already", body = Problem)))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(wanted): Asked<Wanted>,
    asked: HeaderMap,
) -> Result<Response, Failed> {
    if !is_plain_name(&name) {
        return Err(unknown(&name));
    }
    let path = app.backend.recordings_folder().join(&name);
    let is_file = path.symlink_metadata().is_ok_and(|about| about.is_file());
    if !is_file {
        return Err(unknown(&name));
    }
    let stem = name.strip_suffix(".mcap").unwrap_or(&name);
    let (kind, name, table) = match wanted.format {
        Form::Mcap => (BYTES, name.clone(), None),
        Form::Csv => (CSV, format!("{stem}.csv"), Some(Table::Samples)),
        Form::HalfCycles => (
            CSV,
            format!("{stem}.half-cycles.csv"),
            Some(Table::HalfCycles),
        ),
        Form::Npz => (BYTES, format!("{stem}.npz"), Some(Table::Arrays)),
    };
    let is_itself = table.is_none();
    let file = match table {
        None => blocking(move || File::open(path))
            .await
            .map_err(|e| unread(&e))?,
        Some(which) => converted(path, which).await?,
    };
    let about = file.metadata().map_err(|e| unread(&e))?;
    let mut headers = HeaderMap::new();
    let part = match is_itself {
        true => {
            let etag = etag(&about);
            let part = part(&asked, &etag, about.len())?;
            headers.insert(ETAG, etag);
            headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
            part
        }
        // It is made anew each time.
        false => None,
    };
    let disposition = format!("attachment; filename=\"{name}\"");
    // A plain name is plain in a header.
    let disposition = HeaderValue::from_str(&disposition).map_err(|_| unknown(&name))?;
    headers.insert(CONTENT_DISPOSITION, disposition);
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    let (status, from, length) = match part {
        None => (StatusCode::OK, 0, about.len()),
        Some(part) => {
            let of = format!("bytes {}-{}/{}", part.start(), part.end(), about.len());
            let of = HeaderValue::from_str(&of).map_err(|_| unknown(&name))?;
            headers.insert(CONTENT_RANGE, of);
            let length = part.end() - part.start() + 1;
            (StatusCode::PARTIAL_CONTENT, *part.start(), length)
        }
    };
    headers.insert(CONTENT_LENGTH, length.into());
    Ok((status, headers, streamed(file, from, length)).into_response())
}

/// Differs where the file does: one under way grows.
fn etag(about: &Metadata) -> HeaderValue {
    let modified = about.modified().ok();
    let since = modified.and_then(|at| at.duration_since(UNIX_EPOCH).ok());
    let tag = format!(
        "\"{:x}-{:x}\"",
        since.unwrap_or_default().as_nanos(),
        about.len()
    );
    // Quotes, digits and letters.
    HeaderValue::from_str(&tag).unwrap_or(HeaderValue::from_static("\"\""))
}

/// The part of a file that is asked for; none where all of it is: several parts at once, or parts of another file, are not had.
fn part(
    asked: &HeaderMap,
    etag: &HeaderValue,
    length: u64,
) -> Result<Option<RangeInclusive<u64>>, Failed> {
    let range = asked.get(RANGE).and_then(|range| range.to_str().ok());
    let is_of_another = asked.get(IF_RANGE).is_some_and(|of| of != etag);
    let Some(range) = range.filter(|_| !is_of_another) else {
        return Ok(None);
    };
    let Ok(ranges) = parse_range_header(range) else {
        return Ok(None);
    };
    let ranges = ranges.validate(length).map_err(|_| {
        let text = format!("the recording has {length} bytes: it has no part {range:?}");
        Failed::new(StatusCode::RANGE_NOT_SATISFIABLE, "range", text)
    })?;
    Ok(match &ranges[..] {
        [one] => Some(one.clone()),
        _ => None,
    })
}

fn unknown(name: &str) -> Failed {
    let text =
        format!("there is no recording {name:?}; /api/v1/recordings lists those that there are");
    Failed::new(StatusCode::NOT_FOUND, "no-recording", text)
}

fn unread(error: &io::Error) -> Failed {
    tracing::warn!(%error, "a recording cannot be read");
    let text = "the recording cannot be read; the daemon's log says why";
    Failed::new(StatusCode::INTERNAL_SERVER_ERROR, "recording", text)
}

async fn blocking<T: Send + 'static>(
    f: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let done = tokio::task::spawn_blocking(f).await;
    done.unwrap_or_else(|panicked| Err(panicked.into()))
}

/// So many bytes of a file from one on, as the socket takes them: it may grow meanwhile.
fn streamed(mut file: File, from: u64, length: u64) -> Body {
    let (chunks, coming) = mpsc::channel::<io::Result<Bytes>>(CHUNKS);
    tokio::spawn(async move {
        let sought = blocking(move || {
            file.seek(SeekFrom::Start(from))?;
            Ok(file)
        });
        let mut rest = match sought.await {
            Ok(file) => file.take(length),
            Err(error) => return drop(chunks.send(Err(error)).await),
        };
        loop {
            let read = blocking(move || {
                let mut bytes = Vec::with_capacity(CHUNK);
                rest.by_ref().take(CHUNK as u64).read_to_end(&mut bytes)?;
                Ok((rest, bytes))
            });
            let (next, chunk) = match read.await {
                Ok((next, bytes)) => (Some(next), Ok(Bytes::from(bytes))),
                Err(error) => (None, Err(error)),
            };
            let is_end = matches!(&chunk, Ok(bytes) if bytes.is_empty());
            // Whoever left wants no more.
            if is_end || chunks.send(chunk).await.is_err() {
                return;
            }
            match next {
                Some(next) => rest = next,
                None => return,
            }
        }
    });
    Body::from_stream(ReceiverStream::new(coming))
}

/// Tells a conversion that nobody waits for it any more, when the request is dropped.
struct Abandoned(Arc<AtomicBool>);

impl Drop for Abandoned {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A table, in a file that goes with its last reader.
async fn converted(path: PathBuf, which: Table) -> Result<File, Failed> {
    let place = CONVERSIONS.try_acquire().map_err(|_| {
        Failed::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "conversions",
            "two recordings are being converted already: try again in a minute, or download the MCAP file",
        )
    })?;
    let stop = Arc::new(AtomicBool::new(false));
    let _abandoned = Abandoned(Arc::clone(&stop));
    let converting = tokio::task::spawn_blocking(move || {
        let _place = place;
        table(&path, which, &stop)
    });
    match converting.await {
        Ok(Ok(file)) => Ok(file),
        Ok(Err(error)) => Err(refused(&error)),
        Err(panicked) => Err(unread(&panicked.into())),
    }
}

fn refused(error: &TableError) -> Failed {
    let (status, word) = match error {
        TableError::Nothing { .. } => (StatusCode::CONFLICT, "nothing"),
        TableError::TooLarge { .. } | TableError::TooLong => {
            (StatusCode::PAYLOAD_TOO_LARGE, "too-large")
        }
        TableError::Recording(why) => {
            tracing::warn!(%why, "a recording cannot be converted");
            let text = "the recording is damaged; download the MCAP file: `ihd inspect` says what of it is whole";
            return Failed::new(StatusCode::CONFLICT, "damaged", text);
        }
        TableError::Write(why) => return unread(why),
        TableError::Stopped => (StatusCode::REQUEST_TIMEOUT, "time-out"),
    };
    Failed::new(status, word, error.to_string())
}
