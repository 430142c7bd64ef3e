//! Page for browsers: its files, and the security headers of all responses.

use axum::extract::Request;
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

use crate::problem::PathName;

/// Content security policy: files of this server only, no inline script or style, no embedding in frames.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data: blob:; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const CORP: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// Minimum size of a compressed response, in bytes; a smaller one fits a packet.
const COMPRESSED_ABOVE: u64 = 1_400;

/// Returns the page.
pub(super) async fn index(headers: HeaderMap) -> Response {
    serve("index.html", &headers)
}

/// Returns a file of the page.
pub(super) async fn file(PathName(path): PathName, headers: HeaderMap) -> Response {
    serve(&path, &headers)
}

fn serve(path: &str, headers: &HeaderMap) -> Response {
    let Some(file) = ihd_ui::file(path) else {
        return super::no_route();
    };
    // Revalidated each time: an old page must not run with a newer daemon.
    let caching = [(CACHE_CONTROL, "no-cache"), (ETAG, &file.etag)];
    if is_cached(headers, &file.etag) {
        return (StatusCode::NOT_MODIFIED, caching).into_response();
    }
    (caching, [(CONTENT_TYPE, file.mime)], file.bytes).into_response()
}

/// Returns `true` if the browser has this version of the file.
fn is_cached(headers: &HeaderMap, etag: &str) -> bool {
    let lists = headers.get_all(IF_NONE_MATCH).into_iter();
    let mut tags = lists.flat_map(|list| list.to_str().unwrap_or_default().split(','));
    tags.any(|tag| tag.trim() == etag || tag.trim() == "*")
}

/// Adds the security headers to every response, and forbids caching unless a route allows it.
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
    let no_store = HeaderValue::from_static("no-store");
    headers.entry(CACHE_CONTROL).or_insert(no_store);
    response
}

/// Compresses text if the client accepts it. Excludes events, which must not wait, and downloads, which have a `Content-Length`.
pub(super) fn compression() -> CompressionLayer<impl Predicate> {
    let excluded = [
        "application/octet-stream",
        "application/zip",
        "text/csv",
        "image/png",
        "font/",
    ];
    let all = SizeAbove::new(COMPRESSED_ABOVE).and(NotForContentType::SSE);
    let [octets, zip, csv, png, font] = excluded.map(NotForContentType::const_new);
    let all = all.and(octets).and(zip).and(csv).and(png).and(font);
    CompressionLayer::new()
        .quality(CompressionLevel::Fastest)
        .compress_when(all)
}
