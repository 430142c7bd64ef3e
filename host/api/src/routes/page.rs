//! The page for a browser: its files, and what every answer tells a browser about itself.

use axum::extract::{Path, Request};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::compression::CompressionLayer;
use tower_http::compression::CompressionLevel;
use tower_http::compression::predicate::{NotForContentType, Predicate, SizeAbove};

/// Nothing but this server's own files, no inline script or style, and in nobody's frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data: blob:; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const CORP: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// What is smaller fits a packet as it is.
const COMPRESSED_ABOVE: u64 = 1_400;

/// The page itself.
pub(super) async fn index(headers: HeaderMap) -> Response {
    answer("index.html", &headers)
}

/// A file of the page.
pub(super) async fn file(Path(path): Path<String>, headers: HeaderMap) -> Response {
    answer(&path, &headers)
}

fn answer(path: &str, headers: &HeaderMap) -> Response {
    let Some(file) = ihd_ui::file(path) else {
        return super::nothing_here();
    };
    // Asked again each time: a page of yesterday does not talk to a daemon of today.
    let kept = [(CACHE_CONTROL, "no-cache"), (ETAG, &file.etag)];
    if holds(headers, &file.etag) {
        return (StatusCode::NOT_MODIFIED, kept).into_response();
    }
    (kept, [(CONTENT_TYPE, file.mime)], file.bytes).into_response()
}

/// Whether the browser has it already.
fn holds(headers: &HeaderMap, etag: &str) -> bool {
    let lists = headers.get_all(IF_NONE_MATCH).into_iter();
    let mut tags = lists.flat_map(|list| list.to_str().unwrap_or_default().split(','));
    tags.any(|tag| tag.trim() == etag || tag.trim() == "*")
}

/// What a browser may do with an answer, whichever it is.
pub(super) async fn protect(request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (CORP, "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    // What a device does now is nothing to keep.
    let never = HeaderValue::from_static("no-store");
    headers.entry(CACHE_CONTROL).or_insert(never);
    response
}

/// Text, where it is asked for compressed. Not events, which must not wait, and not downloads, whose length is told.
pub(super) fn compression() -> CompressionLayer<impl Predicate> {
    let other = [
        "application/octet-stream",
        "application/zip",
        "text/csv",
        "image/png",
        "font/",
    ];
    let all = SizeAbove::new(COMPRESSED_ABOVE).and(NotForContentType::SSE);
    let [octets, zip, csv, png, font] = other.map(NotForContentType::const_new);
    let all = all.and(octets).and(zip).and(csv).and(png).and(font);
    CompressionLayer::new()
        .quality(CompressionLevel::Fastest)
        .compress_when(all)
}
