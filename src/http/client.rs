//! Another wingd's page is asked over one connection, with every wait bounded.

use std::io;
use std::path::Path;
use std::time::Duration;

use axum::body::Bytes;
use axum::http::{HeaderMap, Request, StatusCode, Uri, header};
use http_body_util::{BodyExt, Empty};
use hyper::body::Incoming;
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use super::tls::{self, TlsConnector};

/// For connecting and for the beginning of an answer: a flight's listing is made from its files' names.
const ANSWER_TIME: Duration = Duration::from_secs(30);
/// Without a byte for so long the connection is taken for dead.
const STALL_TIME: Duration = Duration::from_secs(20);

/// Why an address cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadAddress(String);

/// A client of one server.
pub struct Client {
    runtime: Runtime,
    host: String,
    port: u16,
    token: Option<String>,
    connector: Option<TlsConnector>,
    connection: Option<SendRequest<Empty<Bytes>>>,
}

/// An answer whose head has come.
pub struct Answer<'a> {
    runtime: &'a Runtime,
    /// Its status.
    pub status: StatusCode,
    /// Its headers.
    pub headers: HeaderMap,
    body: Incoming,
}

impl Client {
    /// `http://HOST:PORT`, or `https://HOST:PORT` with the certificate that the server must show.
    pub fn new(url: &str, token: Option<String>, certificate: Option<&Path>) -> Result<Self, BadAddress> {
        let bad = |what: String| BadAddress(format!("{url}: {what}"));
        let uri: Uri = url.parse().map_err(|e| bad(format!("{e}; give http://HOST:PORT")))?;
        let host = uri.host().ok_or_else(|| bad("names no host; give http://HOST:PORT".into()))?.to_owned();
        let connector = match (uri.scheme_str(), certificate) {
            (Some("http"), None) => None,
            (Some("http"), Some(_)) => return Err(bad("a certificate is of use with https:// only".into())),
            (Some("https"), Some(file)) => {
                let made = tls::connector(file);
                Some(made.map_err(|(what, mend)| BadAddress(format!("{}: {what}; {mend}", file.display())))?)
            }
            (Some("https"), None) => {
                return Err(bad("give the server's own certificate with --certificate FILE".into()));
            }
            _ => return Err(bad("give http://HOST:PORT or https://HOST:PORT".into())),
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|e| bad(format!("no client could be started: {e}")))?;
        let port = uri.port_u16().unwrap_or(if connector.is_some() { 443 } else { 80 });
        Ok(Self { runtime, host, port, token, connector, connection: None })
    }

    /// Asks for a path, over the connection that is there where there is one.
    pub fn get(&mut self, path: &str, headers: &[(header::HeaderName, String)]) -> io::Result<Answer<'_>> {
        let mut request = Request::get(path).header(header::HOST, format!("{}:{}", self.host, self.port));
        for (name, value) in headers {
            request = request.header(name, value);
        }
        if let Some(token) = &self.token {
            request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        let request = request.body(Empty::new()).map_err(io::Error::other)?;
        let kept = self.connection.take().filter(|c| !c.is_closed());
        let (host, port, connector) = (self.host.as_str(), self.port, self.connector.as_ref());
        let asked = async {
            let mut connection = match kept {
                Some(connection) => connection,
                None => connect(host, port, connector).await?,
            };
            if connection.ready().await.is_err() {
                connection = connect(host, port, connector).await?;
            }
            let response = connection.send_request(request).await.map_err(io::Error::other)?;
            io::Result::Ok((connection, response))
        };
        // The clock belongs to the runtime: the limit begins inside it.
        let asked = self.runtime.block_on(async { timeout(ANSWER_TIME, asked).await });
        let (connection, response) = asked.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))??;
        self.connection = Some(connection);
        let (head, body) = response.into_parts();
        Ok(Answer { runtime: &self.runtime, status: head.status, headers: head.headers, body })
    }

    /// Gives the connection up, with what of an answer is still to come on it.
    pub fn hang_up(&mut self) {
        self.connection = None;
    }
}

impl Answer<'_> {
    /// The next bytes; `None` at the end.
    pub fn chunk(&mut self) -> io::Result<Option<Bytes>> {
        loop {
            let frame = self.runtime.block_on(async { timeout(STALL_TIME, self.body.frame()).await });
            let frame = frame.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))?;
            match frame {
                None => return Ok(None),
                Some(Err(error)) => return Err(io::Error::other(error)),
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(bytes) => return Ok(Some(bytes)),
                    Err(_) => continue,
                },
            }
        }
    }

    /// All of it, up to `most` bytes.
    pub fn whole(mut self, most: usize) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        while let Some(chunk) = self.chunk()? {
            if all.len() + chunk.len() > most {
                return Err(io::Error::other("the answer is longer than it may be"));
            }
            all.extend_from_slice(&chunk);
        }
        Ok(all)
    }
}

async fn connect(
    host: &str,
    port: u16,
    connector: Option<&TlsConnector>,
) -> io::Result<SendRequest<Empty<Bytes>>> {
    let plain = host.trim_start_matches('[').trim_end_matches(']');
    let stream = TcpStream::connect((plain, port)).await?;
    match connector {
        None => shake(TokioIo::new(stream)).await,
        #[cfg(feature = "tls")]
        Some(connector) => {
            use tokio_rustls::rustls::pki_types::ServerName;
            let name = ServerName::try_from(plain.to_owned()).map_err(io::Error::other)?;
            shake(TokioIo::new(connector.connect(name, stream).await?)).await
        }
        #[cfg(not(feature = "tls"))]
        Some(never) => match *never {},
    }
}

async fn shake<S>(stream: S) -> io::Result<SendRequest<Empty<Bytes>>>
where
    S: hyper::rt::Read + hyper::rt::Write + Unpin + Send + 'static,
{
    let (sender, connection) = handshake(stream).await.map_err(io::Error::other)?;
    tokio::spawn(async move {
        // Its errors reach the request that is under way.
        let _ = connection.await;
    });
    Ok(sender)
}
