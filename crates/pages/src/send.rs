//! Responses with file contents: known length, strong ETag, byte ranges.

use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::Response;
use http_body::Frame;
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::mpsc::{Receiver, Sender, channel};

use super::{Refusal, RequestHead};
use wingd_store::{Disk, RealDisk, bundle};

/// Size of the pieces that are sent; of each response three are in memory.
const CHUNK_BYTES: usize = 64 * 1024;

/// Source of one part of a response.
#[derive(Clone, Debug)]
pub enum ContentSource {
    /// Beginning of a file.
    File(PathBuf),
    Bytes(Bytes),
}

impl From<bundle::BundleContent> for ContentSource {
    fn from(content: bundle::BundleContent) -> Self {
        match content {
            bundle::BundleContent::File(path) => Self::File(path),
            bundle::BundleContent::Bytes(bytes) => Self::Bytes(bytes.into()),
        }
    }
}

/// Content of a response: parts with their lengths, sent one after the other.
pub struct Content {
    /// Lengths in bytes and sources, in order.
    pub parts: Vec<(u64, ContentSource)>,
    /// Digest of the whole content, used as ETag.
    pub digest: String,
    pub kind: &'static str,
    /// File name proposed to the client.
    pub save_as: Option<String>,
    /// Whether ranges may be requested. False for growing files: two ranges could come from different states.
    pub by_range: bool,
    /// Permit held while the content is sent.
    pub permit: Option<OwnedSemaphorePermit>,
}

impl Content {
    /// Creates a content of a single part.
    pub fn from_source(
        length: u64,
        source: ContentSource,
        digest: String,
        kind: &'static str,
        by_range: bool,
    ) -> Self {
        Self {
            parts: vec![(length, source)],
            digest,
            kind,
            save_as: None,
            by_range,
            permit: None,
        }
    }

    fn total_length(&self) -> u64 {
        self.parts.iter().map(|(length, _)| length).sum()
    }

    /// Responds to a request with the given method and headers.
    pub fn respond(self, (method, headers): &RequestHead) -> Result<Response, Refusal> {
        let (length, etag) = (self.total_length(), format!("\"{}\"", self.digest));
        if has_etag(headers, header::IF_NONE_MATCH, &etag) {
            return self.build_response_head(StatusCode::NOT_MODIFIED, &etag, None, None);
        }
        // A range of an outdated state would not fit: then the full content is sent.
        let same = headers
            .get(header::IF_RANGE)
            .is_none_or(|value| value == etag.as_str());
        // Ranges are defined for GET only (RFC 9110, 14.2).
        let allowed = self.by_range && same && method == Method::GET;
        let range = headers
            .get(header::RANGE)
            .filter(|_| allowed)
            .and_then(|range| range.to_str().ok());
        match range.map_or(RequestedRange::Full, |range| parse_range(range, length)) {
            RequestedRange::Full => {
                self.stream_range(method, StatusCode::OK, &etag, (0, length), None)
            }
            RequestedRange::Part(from, to) => {
                let range = format!("bytes {from}-{}/{length}", to - 1);
                self.stream_range(
                    method,
                    StatusCode::PARTIAL_CONTENT,
                    &etag,
                    (from, to),
                    Some(range),
                )
            }
            RequestedRange::Beyond => {
                let range = Some(format!("bytes */{length}"));
                self.build_response_head(StatusCode::RANGE_NOT_SATISFIABLE, &etag, range, Some(0))
            }
        }
    }

    fn stream_range(
        self,
        method: &Method,
        status: StatusCode,
        etag: &str,
        (from, to): (u64, u64),
        range: Option<String>,
    ) -> Result<Response, Refusal> {
        let mut response = self.build_response_head(status, etag, range, Some(to - from))?;
        if method == Method::HEAD {
            return Ok(response);
        }
        let (sender, receiver) = channel(1);
        let Self { parts, permit, .. } = self;
        tokio::spawn(async move {
            let _permit = permit;
            if let Err(error) = send_range(parts, (from, to), &sender).await {
                // A client that disconnects is no error; a file that cannot be read is one.
                if error.kind() != io::ErrorKind::BrokenPipe {
                    tracing::warn!(%error, "a response was aborted");
                }
                let _ = sender.send(Err(error)).await;
            }
        });
        *response.body_mut() = Body::new(ChunkBody(receiver));
        Ok(response)
    }

    fn build_response_head(
        &self,
        status: StatusCode,
        etag: &str,
        range: Option<String>,
        length: Option<u64>,
    ) -> Result<Response, Refusal> {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = status;
        let mut set = |name: HeaderName, value: String| -> Result<(), Refusal> {
            let value = HeaderValue::try_from(value).map_err(|e| Refusal::Failed(e.to_string()))?;
            response.headers_mut().insert(name, value);
            Ok(())
        };
        set(header::ETAG, etag.to_owned())?;
        // Cached, but revalidated each time: another store may be served at this address later.
        set(header::CACHE_CONTROL, "private, no-cache".to_owned())?;
        set(header::CONTENT_TYPE, self.kind.to_owned())?;
        if self.by_range {
            set(header::ACCEPT_RANGES, "bytes".to_owned())?;
        }
        if let Some(range) = range {
            set(header::CONTENT_RANGE, range)?;
        }
        if let Some(length) = length {
            set(header::CONTENT_LENGTH, length.to_string())?;
        }
        if let Some(name) = &self.save_as {
            set(
                header::CONTENT_DISPOSITION,
                format!("attachment; filename=\"{name}\""),
            )?;
        }
        Ok(response)
    }
}

/// Returns whether the client already has the content with this digest.
pub fn is_cached(headers: &HeaderMap, digest: &str) -> bool {
    has_etag(headers, header::IF_NONE_MATCH, &format!("\"{digest}\""))
}

/// Returns whether a header names this ETag. A weak ETag of the same bytes also matches: proxies weaken the ETag of
/// compressed content (RFC 9110, 13.1.2).
fn has_etag(headers: &HeaderMap, name: HeaderName, etag: &str) -> bool {
    let values = headers
        .get_all(name)
        .into_iter()
        .filter_map(|value| value.to_str().ok());
    let mut values = values.flat_map(|value| value.split(',')).map(str::trim);
    values.any(|value| value == "*" || value.strip_prefix("W/").unwrap_or(value) == etag)
}

/// Result of parsing a Range header.
#[derive(Debug, PartialEq)]
enum RequestedRange {
    /// The full content: another unit, several ranges or an invalid range are ignored (RFC 9110, 14.2).
    Full,
    /// Begin and end of a range, bytes; the end is exclusive.
    Part(u64, u64),
    /// A range that begins beyond the end.
    Beyond,
}

fn parse_range(range: &str, length: u64) -> RequestedRange {
    let set = range
        .split_once('=')
        .filter(|(unit, _)| unit.trim().eq_ignore_ascii_case("bytes"));
    let mut ranges = set
        .map_or("", |(_, set)| set)
        .split(',')
        .map(str::trim)
        .filter(|range| !range.is_empty());
    let one = ranges.next().filter(|_| ranges.next().is_none());
    one.and_then(|range| parse_single_range(range, length))
        .unwrap_or(RequestedRange::Full)
}

/// Parses a single range; `None` if the syntax is invalid.
fn parse_single_range(range: &str, length: u64) -> Option<RequestedRange> {
    let (from, to) = range.split_once('-')?;
    // A number that does not fit is beyond any end.
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        digits.then(|| text.parse::<u64>().unwrap_or(u64::MAX))
    };
    if from.is_empty() {
        let last = number(to)?.min(length);
        return Some(if last > 0 {
            RequestedRange::Part(length - last, length)
        } else {
            RequestedRange::Beyond
        });
    }
    let from = number(from)?;
    let end = if to.is_empty() {
        length
    } else {
        number(to)?.saturating_add(1).min(length)
    };
    if !to.is_empty() && number(to)? < from {
        return None;
    }
    Some(if from < end {
        RequestedRange::Part(from, end)
    } else {
        RequestedRange::Beyond
    })
}

/// Sends the bytes from `from` to `to`. A slow client takes no thread: one is used only while a piece is read.
async fn send_range(
    parts: Vec<(u64, ContentSource)>,
    (from, to): (u64, u64),
    sender: &Sender<io::Result<Bytes>>,
) -> io::Result<()> {
    let gone = |_| io::Error::new(io::ErrorKind::BrokenPipe, "the client disconnected");
    let mut chunk = Vec::new();
    let mut begin = 0;
    for (length, source) in parts {
        let end = begin + length;
        let (mut at, last) = (from.max(begin), to.min(end));
        while at < last {
            let until = last.min(at + (CHUNK_BYTES - chunk.len()) as u64);
            chunk.extend_from_slice(&read_piece(&source, at - begin, until - begin).await?);
            at = until;
            if chunk.len() == CHUNK_BYTES {
                sender
                    .send(Ok(std::mem::take(&mut chunk).into()))
                    .await
                    .map_err(gone)?;
            }
        }
        begin = end;
    }
    if chunk.is_empty() {
        Ok(())
    } else {
        sender.send(Ok(chunk.into())).await.map_err(gone)
    }
}

/// Reads exactly the bytes `from` to `to` of a part; fewer available bytes are an error.
async fn read_piece(source: &ContentSource, from: u64, to: u64) -> io::Result<Bytes> {
    let place = |at: u64| usize::try_from(at).unwrap_or(usize::MAX);
    match source {
        ContentSource::Bytes(bytes) if place(to) <= bytes.len() => {
            Ok(bytes.slice(place(from)..place(to)))
        }
        ContentSource::Bytes(_) => Err(io::ErrorKind::UnexpectedEof.into()),
        ContentSource::File(path) => {
            let path = path.clone();
            let read = tokio::task::spawn_blocking(move || {
                let named =
                    |e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", path.display()));
                let bytes = RealDisk
                    .read_range(&path, from, place(to - from))
                    .map_err(named)?;
                let whole = bytes.len() as u64 == to - from;
                whole
                    .then(|| bytes.into())
                    .ok_or_else(|| named(io::ErrorKind::UnexpectedEof.into()))
            });
            read.await?
        }
    }
}

/// Response body that yields chunks as they arrive.
pub(super) struct ChunkBody(pub Receiver<io::Result<Bytes>>);

impl http_body::Body for ChunkBody {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0
            .poll_recv(context)
            .map(|chunk| chunk.map(|chunk| chunk.map(Frame::data)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_byte_range_is_sent_in_part_and_anything_else_completely() {
        for (range, from, to) in [
            ("bytes=0-9", 0, 10),
            ("Bytes=0-9", 0, 10),
            ("bytes=90-", 90, 100),
            ("bytes=90-999", 90, 100),
            ("bytes=90-99999999999999999999", 90, 100),
            ("bytes=-5", 95, 100),
            ("bytes=-500", 0, 100),
            ("bytes= 1-2", 1, 3),
            ("bytes=,1-2 ,", 1, 3),
        ] {
            assert_eq!(
                parse_range(range, 100),
                RequestedRange::Part(from, to),
                "{range}"
            );
        }
        for beyond in ["bytes=100-", "bytes=-0", "bytes=99999999999999999999-"] {
            assert_eq!(parse_range(beyond, 100), RequestedRange::Beyond, "{beyond}");
        }
        for whole in [
            "",
            "bytes",
            "bytes=",
            "bytes=-",
            "bytes=9-1",
            "bytes=0-1,5-6",
            "items=0-1",
            "bytes=+1-5",
            "bytes=1-5x",
            "bytes=1",
        ] {
            assert_eq!(parse_range(whole, 100), RequestedRange::Full, "{whole}");
        }
        assert_eq!(parse_range("bytes=0-", 0), RequestedRange::Beyond);
    }
}
