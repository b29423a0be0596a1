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

use super::{Asked, Refusal};
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

impl From<bundle::Content> for Source {
    fn from(content: bundle::Content) -> Self {
        match content {
            bundle::Content::File(path) => Self::File(path),
            bundle::Content::Bytes(bytes) => Self::Bytes(bytes.into()),
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
    pub fn answer(self, (method, headers): &Asked) -> Result<Response, Refusal> {
        let (length, etag) = (self.length(), format!("\"{}\"", self.digest));
        if matches(headers, header::IF_NONE_MATCH, &etag) {
            return self.head(StatusCode::NOT_MODIFIED, &etag, None, None);
        }
        // A range of another state than the one that is here would not fit: then all of it is sent.
        let same = !headers.contains_key(header::IF_RANGE) || matches(headers, header::IF_RANGE, &etag);
        let range = headers.get(header::RANGE).filter(|_| self.by_range && same);
        match range.map(|range| parse(range.to_str().unwrap_or_default(), length)) {
            None => self.send(method, StatusCode::OK, &etag, (0, length), None),
            Some(Some((from, to))) => {
                let range = format!("bytes {from}-{}/{length}", to - 1);
                self.send(method, StatusCode::PARTIAL_CONTENT, &etag, (from, to), Some(range))
            }
            Some(None) => {
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

/// Whether a header names this ETag. Weak ones never match: bytes are compared here.
fn matches(headers: &HeaderMap, name: HeaderName, etag: &str) -> bool {
    let values = headers.get_all(name).into_iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|value| [etag, "*"].contains(&value.trim()))
}

/// From and to (not included) of one range; `None` where it cannot be had or is not one range of bytes.
fn parse(range: &str, length: u64) -> Option<(u64, u64)> {
    let (from, to) = range.strip_prefix("bytes=")?.split_once('-')?;
    let number = |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse::<u64>().ok())?;
    match (from.is_empty(), to.is_empty()) {
        (true, true) => None,
        (true, false) => {
            let last = number(to)?.min(length);
            (last > 0).then_some((length - last, length))
        }
        (false, open) => {
            let from = number(from)?;
            let to = if open { length } else { number(to)?.saturating_add(1).min(length) };
            (from < to).then_some((from, to))
        }
    }
}

/// Sends the bytes from `from` to `to`; waits while the client is slow.
fn write(parts: &[(u64, Source)], from: u64, to: u64, sender: &Sender<io::Result<Bytes>>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(CHUNK, Client(sender));
    let mut begin = 0;
    for (length, source) in parts {
        let end = begin + length;
        let (first, last) = (from.max(begin), to.min(end));
        if first < last {
            part(source, first - begin, last - begin, &mut out)?;
        }
        begin = end;
    }
    out.flush()
}

/// Exactly these bytes of a stretch; where there are fewer, that is an error.
fn part(source: &Source, from: u64, to: u64, out: &mut impl Write) -> io::Result<()> {
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
    fn one_range_of_bytes_and_nothing_else() {
        assert_eq!(parse("bytes=0-9", 100), Some((0, 10)));
        assert_eq!(parse("bytes=90-", 100), Some((90, 100)));
        assert_eq!(parse("bytes=90-999", 100), Some((90, 100)));
        assert_eq!(parse("bytes=-5", 100), Some((95, 100)));
        assert_eq!(parse("bytes=-500", 100), Some((0, 100)));
        for bad in [
            "",
            "bytes",
            "bytes=",
            "bytes=-",
            "bytes=9-1",
            "bytes=100-",
            "bytes=-0",
            "bytes=0-1,5-6",
            "lines=0-1",
            "bytes=+1-5",
            "bytes=1-5x",
            "bytes=99999999999999999999-",
            "bytes= 1-2",
        ] {
            assert_eq!(parse(bad, 100), None, "{bad}");
        }
        assert_eq!(parse("bytes=0-", 0), None);
    }
}
