//! Bytes of files are an answer of known length, with a strong ETag, by range.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
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
use crate::store::bundle;

const CHUNK: usize = 256 * 1024;

/// A stretch of an answer.
#[derive(Clone, Debug)]
pub enum Source {
    /// The beginning of a file.
    File(PathBuf),
    /// These bytes.
    Bytes(Bytes),
}

impl From<bundle::BundleContent> for Source {
    fn from(content: bundle::BundleContent) -> Self {
        match content {
            bundle::BundleContent::File(path) => Self::File(path),
            bundle::BundleContent::Bytes(bytes) => Self::Bytes(bytes.into()),
        }
    }
}

/// What is sent: stretches with their lengths, one after the other.
pub struct Content {
    /// In order.
    pub parts: Vec<(u64, Source)>,
    /// Digest of all of it.
    pub digest: String,
    /// Media type.
    pub kind: &'static str,
    /// Name to be saved under.
    pub save_as: Option<String>,
    /// Whether a part of it may be asked for. Not of what grows: two parts could be of two states.
    pub by_range: bool,
    /// Held while it is sent.
    pub permit: Option<OwnedSemaphorePermit>,
}

impl Content {
    /// One stretch.
    pub fn one(length: u64, source: Source, digest: String, kind: &'static str, by_range: bool) -> Self {
        Self { parts: vec![(length, source)], digest, kind, save_as: None, by_range, permit: None }
    }

    fn length(&self) -> u64 {
        self.parts.iter().map(|(length, _)| length).sum()
    }

    /// The answer to a request with this method and these headers.
    pub fn answer(self, (method, headers): &RequestHead) -> Result<Response, Refusal> {
        let (length, etag) = (self.length(), format!("\"{}\"", self.digest));
        if matches(headers, header::IF_NONE_MATCH, &etag) {
            return self.head(StatusCode::NOT_MODIFIED, &etag, None, None);
        }
        // A range of another state than the one that is here would not fit: then all of it is sent.
        let same = headers.get(header::IF_RANGE).is_none_or(|value| value == etag.as_str());
        // Of other methods than GET a range means nothing (RFC 9110, 14.2).
        let asked = self.by_range && same && method == Method::GET;
        let range = headers.get(header::RANGE).filter(|_| asked).and_then(|range| range.to_str().ok());
        match range.map_or(Asked::Whole, |range| parse(range, length)) {
            Asked::Whole => self.send(method, StatusCode::OK, &etag, (0, length), None),
            Asked::Part(from, to) => {
                let range = format!("bytes {from}-{}/{length}", to - 1);
                self.send(method, StatusCode::PARTIAL_CONTENT, &etag, (from, to), Some(range))
            }
            Asked::Beyond => {
                let range = Some(format!("bytes */{length}"));
                self.head(StatusCode::RANGE_NOT_SATISFIABLE, &etag, range, Some(0))
            }
        }
    }

    fn send(
        self,
        method: &Method,
        status: StatusCode,
        etag: &str,
        (from, to): (u64, u64),
        range: Option<String>,
    ) -> Result<Response, Refusal> {
        let mut response = self.head(status, etag, range, Some(to - from))?;
        if method == Method::HEAD {
            return Ok(response);
        }
        let (sender, receiver) = channel(2);
        let Self { parts, permit, .. } = self;
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            if let Err(error) = write(&parts, from, to, &sender) {
                // A client that goes away is none of our faults; a file that cannot be read is.
                if error.kind() != io::ErrorKind::BrokenPipe {
                    tracing::warn!(%error, "an answer was broken off");
                }
                let _ = sender.blocking_send(Err(error));
            }
        });
        *response.body_mut() = Body::new(Chunks(receiver));
        Ok(response)
    }

    fn head(
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
        // Kept, but asked for anew each time: another store may be at this address tomorrow.
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
            set(header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\""))?;
        }
        Ok(response)
    }
}

/// Whether the client has what has this digest.
pub fn is_known(headers: &HeaderMap, digest: &str) -> bool {
    matches(headers, header::IF_NONE_MATCH, &format!("\"{digest}\""))
}

/// Whether a header names this ETag. A weak one of the same bytes will do: proxies weaken what they compress (RFC 9110,
/// 13.1.2).
fn matches(headers: &HeaderMap, name: HeaderName, etag: &str) -> bool {
    let values = headers.get_all(name).into_iter().filter_map(|value| value.to_str().ok());
    let mut values = values.flat_map(|value| value.split(',')).map(str::trim);
    values.any(|value| value == "*" || value.strip_prefix("W/").unwrap_or(value) == etag)
}

/// What a Range header asks for.
#[derive(Debug, PartialEq)]
enum Asked {
    /// All of it: another unit, several ranges, or no range by the grammar, which are all left unheeded (RFC 9110, 14.2).
    Whole,
    /// From and to, which is not included.
    Part(u64, u64),
    /// A range that begins behind the end.
    Beyond,
}

fn parse(range: &str, length: u64) -> Asked {
    let set = range.split_once('=').filter(|(unit, _)| unit.trim().eq_ignore_ascii_case("bytes"));
    let mut ranges =
        set.map_or("", |(_, set)| set).split(',').map(str::trim).filter(|range| !range.is_empty());
    let one = ranges.next().filter(|_| ranges.next().is_none());
    one.and_then(|range| part(range, length)).unwrap_or(Asked::Whole)
}

/// One range; `None` where it is none by the grammar.
fn part(range: &str, length: u64) -> Option<Asked> {
    let (from, to) = range.split_once('-')?;
    // A number too large to count is beyond any end.
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        digits.then(|| text.parse::<u64>().unwrap_or(u64::MAX))
    };
    if from.is_empty() {
        let last = number(to)?.min(length);
        return Some(if last > 0 { Asked::Part(length - last, length) } else { Asked::Beyond });
    }
    let from = number(from)?;
    let end = if to.is_empty() { length } else { number(to)?.saturating_add(1).min(length) };
    if !to.is_empty() && number(to)? < from {
        return None;
    }
    Some(if from < end { Asked::Part(from, end) } else { Asked::Beyond })
}

/// Sends the bytes from `from` to `to`; waits while the client is slow.
fn write(parts: &[(u64, Source)], from: u64, to: u64, sender: &Sender<io::Result<Bytes>>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(CHUNK, Client(sender));
    let mut begin = 0;
    for (length, source) in parts {
        let end = begin + length;
        let (first, last) = (from.max(begin), to.min(end));
        if first < last {
            stretch(source, first - begin, last - begin, &mut out)?;
        }
        begin = end;
    }
    out.flush()
}

/// Exactly these bytes of a stretch; where there are fewer, that is an error.
fn stretch(source: &Source, from: u64, to: u64, out: &mut impl Write) -> io::Result<()> {
    match source {
        Source::Bytes(bytes) => {
            let place = |at: u64| usize::try_from(at).unwrap_or(usize::MAX);
            out.write_all(bytes.get(place(from)..place(to)).ok_or(io::ErrorKind::UnexpectedEof)?)
        }
        Source::File(path) => {
            let named = |e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", path.display()));
            let mut file = File::open(path).map_err(named)?;
            file.seek(SeekFrom::Start(from)).map_err(named)?;
            let copied = io::copy(&mut file.take(to - from), out).map_err(named)?;
            if copied < to - from { Err(named(io::ErrorKind::UnexpectedEof.into())) } else { Ok(()) }
        }
    }
}

/// Takes chunks for the client, and waits while it is slow.
struct Client<'a>(&'a Sender<io::Result<Bytes>>);

impl Write for Client<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let gone = |_| io::Error::new(io::ErrorKind::BrokenPipe, "the client went away");
        self.0.blocking_send(Ok(Bytes::copy_from_slice(bytes))).map_err(gone)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An answer's body, as its chunks come.
pub(super) struct Chunks(pub Receiver<io::Result<Bytes>>);

impl http_body::Body for Chunks {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0.poll_recv(context).map(|chunk| chunk.map(|chunk| chunk.map(Frame::data)))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn one_range_of_bytes_is_a_part_and_all_else_is_the_whole() {
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
            assert_eq!(parse(range, 100), Asked::Part(from, to), "{range}");
        }
        for beyond in ["bytes=100-", "bytes=-0", "bytes=99999999999999999999-"] {
            assert_eq!(parse(beyond, 100), Asked::Beyond, "{beyond}");
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
            assert_eq!(parse(whole, 100), Asked::Whole, "{whole}");
        }
        assert_eq!(parse("bytes=0-", 0), Asked::Beyond);
    }
}
