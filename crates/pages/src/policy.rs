//! Content Security Policy (level 3) of the pages: allowed sources and scripts.

use axum::http::{HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use maud::Markup;

/// Policy of pages without a script.
pub const PLAIN: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'";

/// Policy of pages with a script of their own, and images that it has fetched.
const SCRIPTED: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'self'; connect-src 'self'; \
     img-src 'self' data: blob:; frame-ancestors 'none'";

/// Returns a page with a script of its own.
pub fn scripted_page(page: Markup) -> Response {
    let policy = [(
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static(SCRIPTED),
    )];
    (policy, Html(page.into_string())).into_response()
}

/// Returns the script of a page.
pub fn script_response(text: &'static str) -> Response {
    (
        [(header::CONTENT_TYPE, "text/javascript; charset=utf-8")],
        text,
    )
        .into_response()
}
