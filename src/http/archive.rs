//! A flight as one tar archive, made while it is sent.

use std::fs::File;
use std::io::{self, Read, Write};
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use http_body::Frame;
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::mpsc::{Receiver, Sender, channel};

use super::files::Place;

const CHUNK: usize = 256 * 1024;

/// Begins the archive; it stops where the client goes away, and breaks off, without a proper end,
/// where a file cannot be read, so that half an archive is not taken for a whole one.
pub fn stream(flight: &str, files: Vec<Place>, permit: OwnedSemaphorePermit) -> Response {
    let (sender, receiver) = channel(2);
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        if let Err(error) = write(&files, sender.clone()) {
            let _ = sender.blocking_send(Err(error));
        }
    });
    let name = format!("attachment; filename=\"{flight}.tar\"");
    let headers = [
        (header::CONTENT_TYPE, "application/x-tar".to_owned()),
        (header::CONTENT_DISPOSITION, name),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ];
    (headers, Body::new(Chunks(receiver))).into_response()
}

fn write(files: &[Place], sender: Sender<io::Result<Bytes>>) -> io::Result<()> {
    let chunks = Writer { sender, buffer: Vec::with_capacity(CHUNK) };
    let mut archive = tar::Builder::new(chunks);
    for place in files {
        append(&mut archive, place)?;
    }
    archive.into_inner()?.flush()
}

/// What grows is taken as long as it is now.
fn append(archive: &mut tar::Builder<Writer>, place: &Place) -> io::Result<()> {
    let file = File::open(&place.path)?;
    let about = file.metadata()?;
    let mut head = tar::Header::new_gnu();
    head.set_metadata_in_mode(&about, tar::HeaderMode::Deterministic);
    let modified = about.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
    head.set_mtime(modified.map_or(0, |age| age.as_secs()));
    head.set_size(about.len());
    archive.append_data(&mut head, &place.name, file.take(about.len()))
}

/// Collects bytes to chunks for the answer; waits while the client is slow.
struct Writer {
    sender: Sender<io::Result<Bytes>>,
    buffer: Vec<u8>,
}

impl Write for Writer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= CHUNK {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let chunk = std::mem::replace(&mut self.buffer, Vec::with_capacity(CHUNK));
        let gone = |_| io::Error::new(io::ErrorKind::BrokenPipe, "the client went away");
        if chunk.is_empty() { Ok(()) } else { self.sender.blocking_send(Ok(chunk.into())).map_err(gone) }
    }
}

/// The answer's body.
struct Chunks(Receiver<io::Result<Bytes>>);

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
