//! Content Security Policy (level 3) of the pages: allowed sources and scripts.

use axum::http::HeaderValue;
use base64::Engine;
use sha2::{Digest, Sha256};

/// Policy of pages without a script.
pub const PLAIN: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'";

/// Returns the policy of a report: only its own `script`, by hash; `blob:` is needed to save a figure as PNG.
pub fn report_policy(script: &str) -> HeaderValue {
    let hash = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(script));
    let policy = format!(
        "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data: blob:; script-src 'sha256-{hash}'; \
         frame-ancestors 'none'"
    );
    HeaderValue::from_str(&policy).unwrap_or(HeaderValue::from_static(PLAIN))
}
