//! Content Security Policy (level 3) of the pages: allowed sources and scripts.

use axum::http::{HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use base64::Engine;
use maud::Markup;
use sha2::{Digest, Sha256};

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

/// Returns the policy of a report: only its own `script`, by hash; `blob:` is needed to save a figure as PNG.
pub fn report_policy(script: &str) -> HeaderValue {
    let hash = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(script));
    let policy = format!(
        "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data: blob:; script-src 'sha256-{hash}'; \
         frame-ancestors 'none'"
    );
    HeaderValue::from_str(&policy).unwrap_or(HeaderValue::from_static(PLAIN))
}
