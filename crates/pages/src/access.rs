//! Access rules of the pages: a token beyond the loopback interface, and only names of this machine in the Host header, so
//! that a page of another site whose name resolves to this machine cannot read the store through its visitor's browser (DNS
//! rebinding).

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::tls::TlsAcceptor;

/// Answer to an address without the token that it must have.
const OLD_ADDRESS: &str = "this address has no token, or that of an earlier start: open the address that was printed last";
/// Minimum number of characters of a token: shorter ones can be guessed over a network.
const MIN_TOKEN_LENGTH: usize = 16;

/// Delay of a refusal: slows down guesses.
const REFUSAL_DELAY: Duration = Duration::from_millis(200);
/// Minimum number of different characters of a token: `aaaaaaaaaaaaaaaa` can be guessed too.
const MIN_TOKEN_CHARACTERS: usize = 5;

/// Address that a request comes from.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub SocketAddr);

/// Access rules of a server, and counts of the requests that they refused.
#[derive(Default)]
pub struct Access {
    /// SHA-256 of the token, so that the comparison takes the same time for tokens of any length.
    token: Option<[u8; 32]>,
    /// Names of this machine in lower case, in addition to `localhost` and IP addresses.
    hosts: Vec<String>,
    counts: RefusalCounts,
    /// If set, connections must use TLS.
    tls: Option<TlsAcceptor>,
    /// Whether the token may also be in the address, after `?token=`.
    in_address: bool,
}

#[derive(Debug, Default)]
struct RefusalCounts {
    token: AtomicU64,
    host: AtomicU64,
    connections: AtomicU64,
    busy: AtomicU64,
}

impl Access {
    /// Creates the rules. `hosts` are the names by which clients may address this machine.
    pub fn new(token: Option<&str>, hosts: Vec<String>) -> Self {
        let token = token.map(|token| Sha256::digest(token).into());
        let hosts = hosts.iter().map(|host| host.to_ascii_lowercase()).collect();
        Self {
            token,
            hosts,
            counts: RefusalCounts::default(),
            tls: None,
            in_address: false,
        }
    }

    /// Requires TLS if `tls` is given.
    pub fn with_tls(self, tls: Option<TlsAcceptor>) -> Self {
        Self { tls, ..self }
    }

    /// Requires `token`, which may also be in the address, after `?token=`: for a page that one person opens.
    pub fn with_address_token(self, token: &str) -> Self {
        Self {
            token: Some(Sha256::digest(token).into()),
            in_address: true,
            ..self
        }
    }

    /// Returns the TLS settings, or `None` for plain HTTP.
    pub fn tls(&self) -> Option<&TlsAcceptor> {
        self.tls.as_ref()
    }

    /// Returns the number of refused requests by reason, as JSON.
    pub fn refusal_counts(&self) -> Value {
        let count = |n: &AtomicU64| n.load(Ordering::Relaxed);
        json!({"token": count(&self.counts.token), "host": count(&self.counts.host),
            "connections": count(&self.counts.connections), "busy": count(&self.counts.busy)})
    }

    /// Counts an answer for which there was no memory or no turn.
    pub(super) fn count_busy(&self) {
        self.counts.busy.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn count_connection(&self) -> u64 {
        self.counts.connections.fetch_add(1, Ordering::Relaxed) + 1
    }

    fn accepts_host(&self, headers: &HeaderMap) -> bool {
        let mut hosts = headers.get_all(header::HOST).into_iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            return false;
        };
        let Some(name) = host.to_str().ok().and_then(strip_port) else {
            return false;
        };
        let name = name.to_ascii_lowercase();
        let address = name
            .trim_start_matches('[')
            .trim_end_matches(']')
            .parse::<IpAddr>()
            .is_ok();
        address || name == "localhost" || self.hosts.contains(&name)
    }

    fn accepts_token(&self, headers: &HeaderMap, query: Option<&str>) -> bool {
        let Some(expected) = &self.token else {
            return true;
        };
        let given = headers
            .get(header::AUTHORIZATION)
            .and_then(|value| value.to_str().ok())
            .and_then(authorization_token);
        let in_address = || {
            query
                .filter(|_| self.in_address)?
                .strip_prefix("token=")
                .map(str::to_owned)
        };
        let given = given.or_else(in_address);
        let digest: [u8; 32] = Sha256::digest(given.unwrap_or_default()).into();
        digest.ct_eq(expected).into()
    }
}

/// Removes the port from `name`, `name:port` or `[address]:port`; `None` if the text has another form.
fn strip_port(host: &str) -> Option<&str> {
    let end = if host.starts_with('[') {
        host.find(']')? + 1
    } else {
        host.find(':').unwrap_or(host.len())
    };
    let (name, rest) = host.split_at(end);
    let port = rest
        .strip_prefix(':')
        .map(|port| port.bytes().all(|byte| byte.is_ascii_digit()));
    (rest.is_empty() || port == Some(true)).then_some(name)
}

/// Returns the token of an Authorization header: that of `Bearer`, or the password of `Basic`, which browsers can ask for.
fn authorization_token(authorization: &str) -> Option<String> {
    let (scheme, value) = authorization.split_once(' ')?;
    let value = value.trim();
    if scheme.eq_ignore_ascii_case("bearer") {
        return Some(value.to_owned());
    }
    let decoded = base64::engine::general_purpose::STANDARD
        .decode(value)
        .ok()?;
    let text = String::from_utf8(decoded)
        .ok()
        .filter(|_| scheme.eq_ignore_ascii_case("basic"))?;
    text.split_once(':')
        .map(|(_, password)| password.to_owned())
}

/// Reads a token from a file. The error is the problem and the remedy; it never contains the token.
pub fn read_token(file: &Path) -> Result<String, (String, String)> {
    let remedy = format!(
        "write a token of at least {MIN_TOKEN_LENGTH} characters, for example `openssl rand -hex 16`"
    );
    let text = wingd_base::regular_file::read_small_text(file)
        .map_err(|e| (format!("cannot be read ({e})"), remedy.clone()))?;
    let token = text.trim();
    let length = token.chars().count();
    if length < MIN_TOKEN_LENGTH {
        return Err((
            format!("contains a token of only {length} characters"),
            remedy,
        ));
    }
    let different = token
        .chars()
        .collect::<std::collections::BTreeSet<_>>()
        .len();
    if different < MIN_TOKEN_CHARACTERS {
        return Err((
            format!("contains a token of only {different} different characters"),
            remedy,
        ));
    }
    if !token.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err((
            "contains a token with spaces or characters that are not allowed in a header"
                .to_owned(),
            remedy,
        ));
    }
    Ok(token.to_owned())
}

/// Returns a sentence if every user of this machine can read a secret.
pub(super) fn exposure_warning(secret: &Path) -> Option<String> {
    use std::os::unix::fs::PermissionsExt;
    let mode = std::fs::metadata(secret).ok()?.permissions().mode();
    (mode & 0o004 != 0).then(|| {
        format!(
            "{}: every user of this machine can read it; chmod 600",
            secret.display()
        )
    })
}

/// Passes a request on or refuses it. The log entry contains no header of the request.
pub(super) async fn check_access(
    State(access): State<Arc<Access>>,
    request: Request,
    next: Next,
) -> Response {
    let headers = request.headers();
    let (count, reason, status) = if !access.accepts_host(headers) {
        (
            &access.counts.host,
            "the Host header does not name this machine",
            StatusCode::MISDIRECTED_REQUEST,
        )
    } else if !access.accepts_token(headers, request.uri().query()) {
        let reason = if access.in_address {
            OLD_ADDRESS
        } else {
            "token missing or wrong"
        };
        (&access.counts.token, reason, StatusCode::UNAUTHORIZED)
    } else {
        return next.run(request).await;
    };
    let count = count.fetch_add(1, Ordering::Relaxed) + 1;
    // One line each time the count doubles: an attack must not fill the log.
    if count.is_power_of_two() {
        let peer = request
            .extensions()
            .get::<Peer>()
            .map(|peer| peer.0.ip().to_string());
        tracing::warn!(
            peer = peer.unwrap_or_default(),
            reason,
            count,
            "request refused"
        );
    }
    tokio::time::sleep(REFUSAL_DELAY).await;
    let mut response = (status, format!("{reason}\n")).into_response();
    // Nobody knows a token that was made for an address: a browser must not ask for it.
    if status == StatusCode::UNAUTHORIZED && !access.in_address {
        for scheme in [
            "Bearer realm=\"wingd\"",
            "Basic realm=\"wingd: any name, the token as password\"",
        ] {
            response
                .headers_mut()
                .append(header::WWW_AUTHENTICATE, HeaderValue::from_static(scheme));
        }
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(value: &'static str) -> bool {
        let headers = HeaderMap::from_iter([(header::HOST, HeaderValue::from_static(value))]);
        Access::new(None, vec!["Seat-12a.local".to_owned()]).accepts_host(&headers)
    }

    #[test]
    fn only_names_of_this_machine_are_hosts() {
        for good in [
            "localhost",
            "127.0.0.1:8080",
            "[::1]:8080",
            "192.168.4.1",
            "seat-12A.local:80",
        ] {
            assert!(host(good), "{good}");
        }
        for bad in [
            "",
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "[::1",
            "a:b",
            "127.0.0.1:80:80",
        ] {
            assert!(!host(bad), "{bad}");
        }
        assert!(!Access::new(None, vec![]).accepts_host(&HeaderMap::new()));
    }

    #[test]
    fn the_token_comes_as_bearer_or_as_password() {
        let access = Access::new(Some("0123456789abcdef"), vec![]);
        let asks = |value: &str| {
            let value = HeaderValue::from_str(value).unwrap();
            access.accepts_token(
                &HeaderMap::from_iter([(header::AUTHORIZATION, value)]),
                None,
            )
        };
        let basic = base64::engine::general_purpose::STANDARD.encode("me:0123456789abcdef");
        assert!(asks("Bearer 0123456789abcdef") && asks(&format!("Basic {basic}")));
        for bad in [
            "Bearer",
            "Bearer ",
            "Bearer 0123456789abcdeg",
            "0123456789abcdef",
            "Digest 0123456789abcdef",
            "Basic !",
        ] {
            assert!(!asks(bad), "{bad}");
        }
        let query = Some("token=0123456789abcdef");
        assert!(
            !access.accepts_token(&HeaderMap::new(), None)
                && !access.accepts_token(&HeaderMap::new(), query)
        );
        let access = access.with_address_token("0123456789abcdef");
        assert!(
            access.accepts_token(&HeaderMap::new(), query)
                && !access.accepts_token(&HeaderMap::new(), Some(""))
        );
    }
}
