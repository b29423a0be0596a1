//! What a page may load and run (Content Security Policy, level 3).

use axum::http::HeaderValue;
use base64::Engine;
use sha2::{Digest, Sha256};

use crate::report::html;

/// Pages without a script.
pub const PLAIN: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'";

/// A report: its script runs by its hash, and none beside it; `blob:` is a figure on its way to a PNG.
pub fn report() -> HeaderValue {
    let hash = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(html::SCRIPT));
    let policy = format!(
        "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data: blob:; script-src 'sha256-{hash}'; \
         frame-ancestors 'none'"
    );
    HeaderValue::from_str(&policy).unwrap_or(HeaderValue::from_static(PLAIN))
}
