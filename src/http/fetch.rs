//! A flight comes from another wingd's page into a directory, resumed as often as the connection breaks.

use std::io;
use std::thread::sleep;
use std::time::Duration;

use axum::body::Bytes;
use axum::http::{StatusCode, header};
use serde_json::Value;

use super::client::{Answer, Client};
use crate::store::StoreError;
use crate::store::receive::{ListedFile, Listing, Receiver};

/// Tries in a row that bring nothing.
const TRIES: u32 = 8;
/// Pause before the second; doubled each time.
const PAUSE: Duration = Duration::from_millis(250);
/// Files that are here already are read over where they are shorter than a new request is worth.
const GAP: u64 = 1 << 20;
/// Of a listing or a status: 200 bytes a file, far above any flight.
const MAX_LISTING_BYTES: usize = 256 << 20;

/// Why a flight did not come.
#[derive(Debug, thiserror::Error)]
pub enum FetchError {
    /// The connection broke again and again.
    #[error("the connection broke: {0}; what has come is kept, the same command goes on from there")]
    Broken(io::Error),
    /// The server has an answer, and it is no.
    #[error("{path}: the server answers {status}{why}")]
    Refused {
        /// What was asked for.
        path: String,
        /// Its answer.
        status: StatusCode,
        /// A mend, where one is known.
        why: &'static str,
    },
    /// What came is not what a page of ours sends.
    #[error("{path}: {what}; is it the page of a wingd of this version?")]
    Strange {
        /// What was asked for.
        path: String,
        /// What is wrong.
        what: String,
    },
    /// It could not be kept here.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl FetchError {
    /// Whether asking again may help.
    fn passes(&self) -> bool {
        match self {
            Self::Broken(_) => true,
            Self::Refused { status, .. } => status.is_server_error(),
            Self::Strange { .. } | Self::Store(_) => false,
        }
    }
}

/// The names of the server's flights.
pub fn flights(client: &mut Client) -> Result<Vec<String>, FetchError> {
    let path = "/status.json";
    let value: Value = with_retries(|| json(client, path))?;
    let names = value.get("flights").and_then(Value::as_array).cloned().unwrap_or_default();
    Ok(names.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect())
}

fn json<T: serde::de::DeserializeOwned>(client: &mut Client, path: &str) -> Result<T, FetchError> {
    let answer = client.get(path, &[]).map_err(FetchError::Broken)?;
    let answer = expected(answer, path, StatusCode::OK)?;
    let bytes = answer.whole(MAX_LISTING_BYTES).map_err(FetchError::Broken)?;
    let strange = |e: serde_json::Error| FetchError::Strange { path: path.to_owned(), what: e.to_string() };
    serde_json::from_slice(&bytes).map_err(strange)
}

fn expected<'a>(answer: Answer<'a>, path: &str, wanted: StatusCode) -> Result<Answer<'a>, FetchError> {
    let status = answer.status;
    if status == wanted {
        return Ok(answer);
    }
    let why = match status {
        StatusCode::UNAUTHORIZED => "; give its token with --token-file FILE",
        StatusCode::NOT_FOUND => "; it has no such flight",
        StatusCode::MISDIRECTED_REQUEST => "; call it by its address, or let it know the name (--host)",
        StatusCode::SERVICE_UNAVAILABLE => "; other downloads are running there",
        StatusCode::INTERNAL_SERVER_ERROR => "; `wingd verify` there says what is damaged",
        _ => "",
    };
    Err(FetchError::Refused { path: path.to_owned(), status, why })
}

/// Asks again with growing pauses while that may help.
fn with_retries<T>(mut ask: impl FnMut() -> Result<T, FetchError>) -> Result<T, FetchError> {
    let mut tries = 0;
    loop {
        match ask() {
            Err(error) if error.passes() && tries + 1 < TRIES => {
                sleep(PAUSE * 2_u32.pow(tries));
                tries += 1;
            }
            done => return done,
        }
    }
}

/// Brings a flight here, all of it in one state. `thorough`: reads what is here already and brings
/// what is damaged anew. `progress` gets the bytes there are and those that have come.
pub fn flight(
    client: &mut Client,
    receiver: &Receiver,
    flight: &str,
    thorough: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(), FetchError> {
    let path = format!("/bundle/{flight}.json");
    let mut tries = 0;
    loop {
        let listing: Listing = with_retries(|| json(client, &path))?;
        let other = (listing.flight != flight).then(|| format!("lists flight {}", listing.flight));
        if let Some(what) = other.or_else(|| listing.foreign_file()) {
            return Err(FetchError::Strange { path, what });
        }
        receiver.prepare_flight(&listing)?;
        let missing = receiver.missing_files(&listing, thorough);
        if missing.is_empty() {
            return Ok(receiver.commit_flight(&listing)?);
        }
        let mut left: u64 = missing.iter().map(|item| item.length).sum();
        let whole = listing.total_bytes();
        progress(whole - left, whole);
        let before = left;
        let outcome = runs(&missing).into_iter().try_for_each(|run| {
            take(client, &listing, run, receiver, &mut |bytes| {
                left -= bytes;
                progress(whole - left, whole);
            })
        });
        tries = if left < before { 0 } else { tries + 1 };
        client.hang_up();
        match outcome {
            Err(error) if !error.passes() || tries >= TRIES => return Err(error),
            Err(_) => sleep(PAUSE * 2_u32.pow(tries)),
            // All of it, or of a state that is past: the next listing tells.
            Ok(()) => {}
        }
    }
}

/// Files that lie together in the archive, each run for one request.
fn runs<'l, 'm>(missing: &'m [&'l ListedFile]) -> Vec<&'m [&'l ListedFile]> {
    let near = |a: &&ListedFile, b: &&ListedFile| b.offset.saturating_sub(a.offset + a.length) <= GAP;
    missing.chunk_by(near).collect()
}

/// One request's files, each kept as soon as it has come.
fn take(
    client: &mut Client,
    listing: &Listing,
    run: &[&ListedFile],
    receiver: &Receiver,
    came: &mut dyn FnMut(u64),
) -> Result<(), FetchError> {
    let (Some(first), Some(last)) = (run.first(), run.last()) else { return Ok(()) };
    let path = format!("/tar/{}.tar", listing.flight);
    let range = format!("bytes={}-{}", first.offset, (last.offset + last.length).saturating_sub(1));
    let headers = [(header::RANGE, range), (header::IF_RANGE, format!("\"{}\"", listing.digest))];
    let answer = client.get(&path, &headers).map_err(FetchError::Broken)?;
    if answer.status == StatusCode::OK {
        return Ok(());
    }
    let mut stretch =
        Stretch { answer: expected(answer, &path, StatusCode::PARTIAL_CONTENT)?, rest: Bytes::new() };
    let mut at = first.offset;
    for item in run {
        stretch.skip(item.offset - at).map_err(FetchError::Broken)?;
        let bytes = stretch.take(item.length).map_err(FetchError::Broken)?;
        receiver.accept_file(item, &bytes)?;
        came(item.length);
        at = item.offset + item.length;
    }
    Ok(())
}

/// The bytes of an answer, cut as they are wanted.
struct Stretch<'a> {
    answer: Answer<'a>,
    rest: Bytes,
}

impl Stretch<'_> {
    fn each(&mut self, mut length: u64, mut part: impl FnMut(&[u8])) -> io::Result<()> {
        while length > 0 {
            if self.rest.is_empty() {
                self.rest = self.answer.chunk()?.ok_or(io::ErrorKind::UnexpectedEof)?;
            }
            let count = self.rest.len().min(usize::try_from(length).unwrap_or(usize::MAX));
            part(&self.rest.split_to(count));
            length -= count as u64;
        }
        Ok(())
    }

    fn skip(&mut self, length: u64) -> io::Result<()> {
        self.each(length, |_| ())
    }

    fn take(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.each(length, |part| bytes.extend_from_slice(part))?;
        Ok(bytes)
    }
}
