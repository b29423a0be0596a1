//! HTTP client for the pages of another wingd: one connection, every wait bounded.

use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::http::{HeaderMap, Request, StatusCode, Uri, header};
use http_body_util::{BodyExt, Empty};
use hyper::body::Incoming;
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use wingd_pages::tls;
use wingd_pages::tls::TlsConnector;

/// Timeout for connecting and for the head of a response; the server lists a flight's files before it responds.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);
/// Time in which a response must bring [`MIN_BYTES`]; otherwise the connection counts as lost.
const STALL_TIMEOUT: Duration = Duration::from_secs(20);
/// Minimum number of bytes in [`STALL_TIMEOUT`], 5 kB/s: at less, a frame of 5 MB takes longer than a quarter of an hour.
const MIN_BYTES: usize = 100_000;

/// Error for a server URL that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ServerUrlError(String);

/// HTTP client of one server.
pub struct Client {
    runtime: Runtime,
    host: String,
    port: u16,
    token: Option<String>,
    connector: Option<TlsConnector>,
    connection: Option<SendRequest<Empty<Bytes>>>,
}

/// Response whose head has arrived and whose body can be read.
pub struct ClientResponse<'a> {
    runtime: &'a Runtime,
    pub status: StatusCode,
    pub headers: HeaderMap,
    body: Incoming,
    rate: RateCheck,
}

/// Checks that a response brings enough bytes in each period.
struct RateCheck {
    begun: Instant,
    bytes: usize,
}

impl RateCheck {
    /// Counts received bytes; returns an error if they were too few since the period began.
    fn add(&mut self, bytes: usize, now: Instant) -> io::Result<()> {
        self.bytes += bytes;
        if now.duration_since(self.begun) < STALL_TIMEOUT {
            return Ok(());
        }
        if self.bytes < MIN_BYTES {
            return Err(io::Error::new(
                io::ErrorKind::TimedOut,
                "the server sends less than 5 kB/s",
            ));
        }
        *self = Self {
            begun: now,
            bytes: 0,
        };
        Ok(())
    }
}

impl Client {
    /// Creates a client for `http://HOST:PORT`, or for `https://HOST:PORT` with the certificate that the server must
    /// present.
    pub fn new(
        url: &str,
        token: Option<String>,
        certificate: Option<&Path>,
    ) -> Result<Self, ServerUrlError> {
        let bad = |problem: String| ServerUrlError(format!("{url}: {problem}"));
        let uri: Uri = url
            .parse()
            .map_err(|e| bad(format!("{e}; give http://HOST:PORT")))?;
        let host = uri
            .host()
            .ok_or_else(|| bad("has no host; give http://HOST:PORT".into()))?
            .to_owned();
        let connector = match (uri.scheme_str(), certificate) {
            (Some("http"), None) => None,
            (Some("http"), Some(_)) => {
                return Err(bad("a certificate can be used with https:// only".into()));
            }
            (Some("https"), Some(file)) => {
                let created = tls::tls_connector(file);
                Some(created.map_err(|(problem, remedy)| {
                    ServerUrlError(format!("{}: {problem}; {remedy}", file.display()))
                })?)
            }
            (Some("https"), None) => {
                return Err(bad(
                    "give the server's own certificate with --certificate FILE".into(),
                ));
            }
            _ => return Err(bad("give http://HOST:PORT or https://HOST:PORT".into())),
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|e| bad(format!("could not start the client: {e}")))?;
        let port = uri
            .port_u16()
            .unwrap_or(if connector.is_some() { 443 } else { 80 });
        Ok(Self {
            runtime,
            host,
            port,
            token,
            connector,
            connection: None,
        })
    }

    /// Requests a path, over the open connection if there is one.
    pub fn get(
        &mut self,
        path: &str,
        headers: &[(header::HeaderName, String)],
    ) -> io::Result<ClientResponse<'_>> {
        let mut request =
            Request::get(path).header(header::HOST, format!("{}:{}", self.host, self.port));
        for (name, value) in headers {
            request = request.header(name, value);
        }
        if let Some(token) = &self.token {
            request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        let request = request.body(Empty::new()).map_err(io::Error::other)?;
        let open = self.connection.take().filter(|c| !c.is_closed());
        let (host, port, connector) = (self.host.as_str(), self.port, self.connector.as_ref());
        let request = async {
            let mut connection = match open {
                Some(connection) => connection,
                None => open_connection(host, port, connector).await?,
            };
            if connection.ready().await.is_err() {
                connection = open_connection(host, port, connector).await?;
            }
            let response = connection
                .send_request(request)
                .await
                .map_err(io::Error::other)?;
            io::Result::Ok((connection, response))
        };
        // A timer must be created inside the runtime.
        let outcome = self
            .runtime
            .block_on(async { timeout(ANSWER_TIMEOUT, request).await });
        let (connection, response) =
            outcome.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))??;
        self.connection = Some(connection);
        let (head, body) = response.into_parts();
        Ok(ClientResponse {
            runtime: &self.runtime,
            status: head.status,
            headers: head.headers,
            body,
            rate: RateCheck {
                begun: Instant::now(),
                bytes: 0,
            },
        })
    }

    /// Closes the connection and discards the rest of a response.
    pub fn disconnect(&mut self) {
        self.connection = None;
    }
}

impl ClientResponse<'_> {
    /// Reads the next bytes of the body; `None` at its end.
    pub fn next_chunk(&mut self) -> io::Result<Option<Bytes>> {
        loop {
            let frame = self
                .runtime
                .block_on(async { timeout(STALL_TIMEOUT, self.body.frame()).await });
            let frame = frame.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))?;
            match frame {
                None => return Ok(None),
                Some(Err(error)) => return Err(io::Error::other(error)),
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(bytes) => {
                        self.rate.add(bytes.len(), Instant::now())?;
                        return Ok(Some(bytes));
                    }
                    Err(_) => continue,
                },
            }
        }
    }

    /// Reads the whole body, up to `max_bytes` bytes.
    pub fn read_all(mut self, max_bytes: usize) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        while let Some(chunk) = self.next_chunk()? {
            if all.len() + chunk.len() > max_bytes {
                return Err(io::Error::new(
                    io::ErrorKind::FileTooLarge,
                    "the response is longer than allowed",
                ));
            }
            all.extend_from_slice(&chunk);
        }
        Ok(all)
    }
}

async fn open_connection(
    host: &str,
    port: u16,
    connector: Option<&TlsConnector>,
) -> io::Result<SendRequest<Empty<Bytes>>> {
    let plain = host.trim_start_matches('[').trim_end_matches(']');
    let stream = TcpStream::connect((plain, port)).await?;
    match connector {
        None => start_http1_session(TokioIo::new(stream)).await,
        #[cfg(feature = "tls")]
        Some(connector) => {
            use tokio_rustls::rustls::pki_types::ServerName;
            let name = ServerName::try_from(plain.to_owned()).map_err(io::Error::other)?;
            start_http1_session(TokioIo::new(connector.connect(name, stream).await?)).await
        }
        #[cfg(not(feature = "tls"))]
        Some(never) => match *never {},
    }
}

async fn start_http1_session<S>(stream: S) -> io::Result<SendRequest<Empty<Bytes>>>
where
    S: hyper::rt::Read + hyper::rt::Write + Unpin + Send + 'static,
{
    let (sender, connection) = handshake(stream).await.map_err(io::Error::other)?;
    tokio::spawn(async move {
        // Errors reach the request in progress.
        let _ = connection.await;
    });
    Ok(sender)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_drips_is_not_waited_for() {
        let begun = Instant::now();
        let at = |second| begun + Duration::from_secs(second);
        let mut rate = RateCheck { begun, bytes: 0 };
        assert!(rate.add(90_000, at(19)).is_ok() && rate.add(10_000, at(20)).is_ok());
        assert!(
            (21..40).all(|second| rate.add(700, at(second)).is_ok())
                && rate.add(700, at(40)).is_err()
        );
    }
}
