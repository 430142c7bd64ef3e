//! Recordings: list, download as files or as tables.

use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::UNIX_EPOCH;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE,
    ETAG, IF_RANGE, RANGE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use http_range_header::parse_range_header;
use ihd_daemon::recording::{RecordingExportError, RecordingTable, is_plain_name, table};
use ihd_model::{Problem, RecordingFile};
use serde::Deserialize;
use tokio::sync::{Semaphore, SemaphorePermit, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use crate::problem::{ApiQuery, ErrorResponse, PathName};

/// Limits simultaneous tables of the process: each keeps a core busy, then room on the disk until it is sent.
static CONVERSIONS: Semaphore = Semaphore::const_new(2);

/// Bytes per read.
const CHUNK: usize = 1 << 17;

/// Maximum number of chunks that wait for the socket.
const CHUNKS: usize = 2;

/// Header of a table: number of damaged records of the recording that it lacks.
const DAMAGED_RECORDS: HeaderName = HeaderName::from_static("ihd-damaged-records");

const BYTES: &str = "application/octet-stream";
const CSV: &str = "text/csv; charset=utf-8";

/// Returns the recordings, newest first.
#[utoipa::path(get, path = "/recordings", operation_id = "recordings", tag = "recordings",
    responses((status = 200, body = [RecordingFile])))]
pub(super) async fn all(
    State(app): State<Arc<App>>,
) -> Result<Json<Vec<RecordingFile>>, ErrorResponse> {
    Ok(Json(app.daemon.recordings().list().await?))
}

/// Format of a download.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Format {
    /// MCAP file as stored.
    #[default]
    Mcap,
    /// Samples of all windows, with the number of the window.
    Csv,
    /// One line per half-cycle.
    HalfCycles,
    /// All data as NumPy arrays.
    Npz,
}

/// Query parameters of a download.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RecordingParameters {
    /// `mcap` (the file as stored; default), `csv` (samples of all windows), `half-cycles` (CSV, one line each) or `npz` (all data, for
    /// NumPy).
    #[serde(default)]
    #[param(value_type = Option<String>)]
    format: Format,
}

/// Downloads a recording; of an active one, the part on disk. MCAP files support `Range` and `If-Range`, so that an interrupted download
/// can be resumed.
///
/// Times in tables are relative to the trigger. CSV has the columns `time_s,v_V,i_A,window`. The table of a damaged recording lacks the
/// damaged parts: its name ends with `.damaged` before the ending, and its header `ihd-damaged-records` counts them.
#[utoipa::path(get, path = "/recordings/{file}", operation_id = "recording", tag = "recordings",
    params(("file" = String, Path, description = "Name of the recording"), RecordingParameters),
    responses((status = 200, description = "The file", content_type = "application/octet-stream", body = Vec<u8>),
        (status = 206, description = "The requested part", content_type = "application/octet-stream", body = Vec<u8>),
        (status = 416, description = "The file has no such part", body = Problem),
        (status = 400, body = Problem), (status = 404, body = Problem),
        (status = 409, description = "The recording contains no such data, or is damaged", body = Problem),
        (status = 413, description = "The table would be too large", body = Problem),
        (status = 503, description = "Two conversions are already in progress, or the disk has no room for one", body = Problem)))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<RecordingParameters>,
    request_headers: HeaderMap,
) -> Result<Response, ErrorResponse> {
    if !is_plain_name(&name) {
        return Err(unknown(&name));
    }
    let path = app.daemon.recordings().folder().join(&name);
    let is_file = path
        .symlink_metadata()
        .is_ok_and(|metadata| metadata.is_file());
    if !is_file {
        return Err(unknown(&name));
    }
    let stem = name.strip_suffix(".mcap").unwrap_or(&name);
    let (kind, ending, table) = match parameters.format {
        Format::Mcap => (BYTES, "mcap", None),
        Format::Csv => (CSV, "csv", Some(RecordingTable::Samples)),
        Format::HalfCycles => (CSV, "half-cycles.csv", Some(RecordingTable::HalfCycles)),
        Format::Npz => (BYTES, "npz", Some(RecordingTable::Arrays)),
    };
    let is_stored_file = table.is_none();
    let (file, damaged_records, permit) = opened(path, table).await?;
    let metadata = file.metadata().map_err(|e| unreadable(&e))?;
    let mut headers = HeaderMap::new();
    let part = match is_stored_file {
        true => {
            let etag = etag(&metadata);
            let part = requested_part(&request_headers, &etag, metadata.len())?;
            headers.insert(ETAG, etag);
            headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
            part
        }
        // A table is generated for each request.
        false => None,
    };
    let mark = if damaged_records > 0 { ".damaged" } else { "" };
    let disposition = format!("attachment; filename=\"{stem}{mark}.{ending}\"");
    // Cannot fail: a plain name is valid in a header.
    let disposition = HeaderValue::from_str(&disposition).map_err(|_| unknown(&name))?;
    headers.insert(CONTENT_DISPOSITION, disposition);
    if damaged_records > 0 {
        headers.insert(DAMAGED_RECORDS, damaged_records.into());
    }
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    let (status, from, length) = match part {
        None => (StatusCode::OK, 0, metadata.len()),
        Some(part) => {
            let range = format!("bytes {}-{}/{}", part.start(), part.end(), metadata.len());
            let range = HeaderValue::from_str(&range).map_err(|_| unknown(&name))?;
            headers.insert(CONTENT_RANGE, range);
            let length = part.end() - part.start() + 1;
            (StatusCode::PARTIAL_CONTENT, *part.start(), length)
        }
    };
    headers.insert(CONTENT_LENGTH, length.into());
    Ok((status, headers, streamed(file, from, length, permit)).into_response())
}

/// File to send, the number of damaged records that it lacks, and the permit for a table.
type Opened = (File, u32, Option<SemaphorePermit<'static>>);

/// Opens a recording, or converts it to a table.
async fn opened(path: PathBuf, table: Option<RecordingTable>) -> Result<Opened, ErrorResponse> {
    let Some(which) = table else {
        let file = blocking(move || File::open(path)).await;
        return Ok((file.map_err(|e| unreadable(&e))?, 0, None));
    };
    let (file, damaged_records, permit) = converted(path, which).await?;
    Ok((file, damaged_records, Some(permit)))
}

/// Returns an ETag from time of change and length: the file of an active recording grows.
fn etag(metadata: &Metadata) -> HeaderValue {
    let modified = metadata.modified().ok();
    let since = modified.and_then(|at| at.duration_since(UNIX_EPOCH).ok());
    let tag = format!(
        "\"{:x}-{:x}\"",
        since.unwrap_or_default().as_nanos(),
        metadata.len()
    );
    // Cannot fail: quotes, digits and letters.
    HeaderValue::from_str(&tag).unwrap_or(HeaderValue::from_static("\"\""))
}

/// Returns the requested part of a file; `None` for the whole file, also if several parts or a part of another version are requested.
fn requested_part(
    headers: &HeaderMap,
    etag: &HeaderValue,
    length: u64,
) -> Result<Option<RangeInclusive<u64>>, ErrorResponse> {
    let range = headers.get(RANGE).and_then(|range| range.to_str().ok());
    let is_outdated = headers.get(IF_RANGE).is_some_and(|tag| tag != etag);
    let Some(range) = range.filter(|_| !is_outdated) else {
        return Ok(None);
    };
    let Ok(ranges) = parse_range_header(range) else {
        return Ok(None);
    };
    let ranges = ranges.validate(length).map_err(|_| {
        let text = format!("the recording has {length} bytes: it has no part {range:?}");
        ErrorResponse::new(StatusCode::RANGE_NOT_SATISFIABLE, "range", text)
    })?;
    Ok(match &ranges[..] {
        [one] => Some(one.clone()),
        _ => None,
    })
}

fn unknown(name: &str) -> ErrorResponse {
    let text =
        format!("there is no recording {name:?}; /api/v1/recordings lists those that there are");
    ErrorResponse::new(StatusCode::NOT_FOUND, "no-recording", text)
}

fn unreadable(error: &io::Error) -> ErrorResponse {
    tracing::warn!(%error, "a recording cannot be read");
    let text = "the recording cannot be read; the daemon's log says why";
    ErrorResponse::new(StatusCode::INTERNAL_SERVER_ERROR, "recording", text)
}

async fn blocking<T: Send + 'static>(
    f: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let done = tokio::task::spawn_blocking(f).await;
    done.unwrap_or_else(|panicked| Err(panicked.into()))
}

/// Returns `length` bytes of a file from offset `from` as a body, read as the socket accepts them; the file may grow meanwhile. The permit
/// is held as long as the file.
fn streamed(
    mut file: File,
    from: u64,
    length: u64,
    permit: Option<SemaphorePermit<'static>>,
) -> Body {
    let (chunks, receiver) = mpsc::channel::<io::Result<Bytes>>(CHUNKS);
    tokio::spawn(async move {
        let _permit = permit;
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
            // An error means that the client is gone.
            if is_end || chunks.send(chunk).await.is_err() {
                return;
            }
            match next {
                Some(next) => rest = next,
                None => return,
            }
        }
    });
    Body::from_stream(ReceiverStream::new(receiver))
}

/// Stops a conversion when its request is dropped.
struct StopOnDrop(Arc<AtomicBool>);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Table in a temporary file, the number of damaged records that it lacks, and the permit for it.
type Converted = (File, u32, SemaphorePermit<'static>);

/// Converts a recording to a table.
async fn converted(path: PathBuf, which: RecordingTable) -> Result<Converted, ErrorResponse> {
    let permit = CONVERSIONS.try_acquire().map_err(|_| {
        ErrorResponse::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "conversions",
            "two recordings are being converted or sent already: try again in a minute, or download the MCAP file",
        )
    })?;
    let stop = Arc::new(AtomicBool::new(false));
    let _stop_on_drop = StopOnDrop(Arc::clone(&stop));
    let converting = tokio::task::spawn_blocking(move || {
        // Dropped with the table if the request was dropped meanwhile.
        table(&path, which, &stop).map(|(file, losses)| (file, losses.damaged, permit))
    });
    match converting.await {
        Ok(Ok(converted)) => Ok(converted),
        Ok(Err(error)) => Err(conversion_error(&error)),
        Err(panicked) => Err(unreadable(&panicked.into())),
    }
}

fn conversion_error(error: &RecordingExportError) -> ErrorResponse {
    let (status, code) = match error {
        RecordingExportError::Nothing { .. } => (StatusCode::CONFLICT, "nothing"),
        RecordingExportError::TooLarge { .. } | RecordingExportError::TooLong => {
            (StatusCode::PAYLOAD_TOO_LARGE, "too-large")
        }
        RecordingExportError::Recording(why) => {
            tracing::warn!(%why, "a recording cannot be converted");
            let text = "the recording is damaged; download the MCAP file: `ihd inspect` says what of it is whole";
            return ErrorResponse::new(StatusCode::CONFLICT, "damaged", text);
        }
        RecordingExportError::Write(why) => return unreadable(why),
        RecordingExportError::NoRoom => (StatusCode::SERVICE_UNAVAILABLE, "no-room"),
        RecordingExportError::Stopped => (StatusCode::REQUEST_TIMEOUT, "time-out"),
    };
    ErrorResponse::new(status, code, error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_table_holds_its_permit_until_it_is_sent_or_given_up() {
        static ONE: Semaphore = Semaphore::const_new(1);
        // More than waits for a socket.
        let length = (2 * CHUNKS * CHUNK) as u64;
        let file = tempfile::tempfile().unwrap();
        file.set_len(length).unwrap();
        let body = streamed(file, 0, length, ONE.try_acquire().ok());
        tokio::task::yield_now().await;
        assert_eq!(ONE.available_permits(), 0);
        drop(body);
        let _permit = ONE.acquire().await.unwrap();
    }
}
