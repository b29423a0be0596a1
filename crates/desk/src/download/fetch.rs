//! Download of flights from the page of another wingd into a directory, resumed each time the connection breaks.

use std::io;
use std::thread::sleep;
use std::time::Duration;

use axum::body::Bytes;
use axum::http::{HeaderValue, StatusCode, header};
use serde_json::Value;

use super::client::{Client, ClientResponse};
use wingd_pages::tls;
use wingd_store::receive::{ListedFile, Listing, Receiver};
use wingd_store::{StoreError, layout};

/// Consecutive attempts without progress after which the download fails.
const MAX_TRIES: u32 = 8;
/// Pause before the second attempt; doubled for each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Files already present are downloaded again if the gap they would leave in a request is at most this long, bytes.
const MAX_GAP_BYTES: u64 = 1 << 20;
/// Maximum size of a listing or a status, bytes: 200 bytes a file, far above any flight.
const MAX_LISTING_BYTES: usize = 64 << 20;
/// Size of the pieces in which a file is received, bytes: each is made durable.
const PIECE_BYTES: usize = 8 << 20;

/// Error of a download.
#[derive(Debug, thiserror::Error)]
pub enum FetchError {
    /// The connection broke repeatedly.
    #[error(
        "the connection broke: {0}; the files received so far are kept, run the same command again to resume"
    )]
    Broken(io::Error),
    /// The connection cannot be made, whatever the number of attempts; the text has the remedy.
    #[error("{0}")]
    Impossible(String),
    /// The server refused the request.
    #[error("{path}: the server responded {status}{why}")]
    Refused {
        path: String,
        status: StatusCode,
        /// Remedy, if one is known; begins with a semicolon.
        why: &'static str,
    },
    /// The response does not have the form that a wingd page sends.
    #[error(
        "{path}: {problem}; check that the server is a wingd of this version, and that no proxy changes its answers"
    )]
    Unexpected { path: String, problem: String },
    /// The flight could not be stored here.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl FetchError {
    /// Classifies an error of the connection.
    fn from_connection(error: io::Error) -> Self {
        let not_http = error
            .get_ref()
            .and_then(|inner| inner.downcast_ref::<hyper::Error>())
            .is_some_and(hyper::Error::is_parse);
        let problem = if not_http {
            let text = "the server does not answer in plain HTTP; if it has a certificate, give https:// and --certificate FILE";
            Some(text.to_owned())
        } else {
            tls::permanent_problem(&error)
        };
        problem.map_or(Self::Broken(error), Self::Impossible)
    }

    /// Returns whether a further attempt may succeed.
    fn is_transient(&self) -> bool {
        match self {
            Self::Broken(_) => true,
            Self::Refused { status, .. } => status.is_server_error(),
            Self::Impossible(_) | Self::Unexpected { .. } | Self::Store(_) => false,
        }
    }
}

/// Returns the names of the server's flights.
pub fn fetch_flight_names(client: &mut Client) -> Result<Vec<String>, FetchError> {
    let path = "/status.json";
    let value: Value = with_retries(|| fetch_json(client, path))?;
    let names = value
        .get("flights")
        .and_then(Value::as_array)
        .cloned()
        .unwrap_or_default();
    Ok(names
        .iter()
        .filter_map(|name| name.as_str().map(str::to_owned))
        .collect())
}

fn fetch_json<T: serde::de::DeserializeOwned>(
    client: &mut Client,
    path: &str,
) -> Result<T, FetchError> {
    let answer = client.get(path, &[]).map_err(FetchError::from_connection)?;
    let answer = check_status(answer, path, StatusCode::OK)?;
    let bytes = answer
        .read_all(MAX_LISTING_BYTES)
        .map_err(|error| match error.kind() {
            io::ErrorKind::FileTooLarge => FetchError::Unexpected {
                path: path.to_owned(),
                problem: error.to_string(),
            },
            _ => FetchError::Broken(error),
        })?;
    let invalid = |e: serde_json::Error| FetchError::Unexpected {
        path: path.to_owned(),
        problem: e.to_string(),
    };
    serde_json::from_slice(&bytes).map_err(invalid)
}

fn check_status<'a>(
    answer: ClientResponse<'a>,
    path: &str,
    expected: StatusCode,
) -> Result<ClientResponse<'a>, FetchError> {
    let status = answer.status;
    if status == expected {
        return Ok(answer);
    }
    let why = match status {
        StatusCode::UNAUTHORIZED => "; give the server's token with --token-file FILE",
        StatusCode::NOT_FOUND => "; the server has no such flight",
        StatusCode::MISDIRECTED_REQUEST => {
            "; use its IP address, or start the server with this name (--host)"
        }
        StatusCode::SERVICE_UNAVAILABLE => "; other downloads are running on the server",
        StatusCode::INTERNAL_SERVER_ERROR => {
            "; run `wingd verify` on the server to find the damage"
        }
        _ => "",
    };
    Err(FetchError::Refused {
        path: path.to_owned(),
        status,
        why,
    })
}

/// Repeats a request with increasing pauses while its error is transient.
fn with_retries<T>(mut ask: impl FnMut() -> Result<T, FetchError>) -> Result<T, FetchError> {
    let mut tries = 0;
    loop {
        match ask() {
            Err(error) if error.is_transient() && tries + 1 < MAX_TRIES => {
                let pause = FIRST_PAUSE * 2_u32.pow(tries);
                let cause = if let FetchError::Broken(cause) = &error {
                    cause.to_string()
                } else {
                    error.to_string()
                };
                eprintln!("wingd: {cause}; next attempt in {} s", pause.as_secs_f64());
                sleep(pause);
                tries += 1;
            }
            done => return done,
        }
    }
}

/// Downloads a flight in one consistent state. `thorough`: also reads the files already present and downloads damaged ones
/// again. `progress` receives the bytes present and the total.
pub fn fetch_flight(
    client: &mut Client,
    receiver: &Receiver,
    flight: &str,
    thorough: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(), FetchError> {
    if layout::flight_number(flight).is_none() {
        let problem = format!("{flight:?} is not the name of a flight");
        return Err(FetchError::Unexpected {
            path: "/status.json".to_owned(),
            problem,
        });
    }
    let path = format!("/bundle/{flight}.json");
    let mut tries = 0;
    loop {
        let listing: Listing = with_retries(|| fetch_json(client, &path))?;
        let other =
            (listing.flight != flight).then(|| format!("lists flight {:?}", listing.flight));
        if let Some(problem) = other.or_else(|| listing.problem()) {
            return Err(FetchError::Unexpected { path, problem });
        }
        receiver.prepare_flight(&listing)?;
        let missing = receiver.missing_files(&listing, thorough);
        if missing.is_empty() {
            return Ok(receiver.commit_flight(&listing)?);
        }
        let mut left: u64 = missing.iter().map(|item| item.length).sum();
        receiver.require_space(left)?;
        let total = listing.total_bytes();
        progress(total - left, total);
        let before = left;
        let outcome = group_adjacent_files(&missing)
            .into_iter()
            .try_for_each(|run| {
                fetch_run(client, &listing, run, receiver, &mut |bytes| {
                    left -= bytes;
                    progress(total - left, total);
                })
            });
        tries = if left < before { 0 } else { tries + 1 };
        client.disconnect();
        match outcome {
            Err(error) if !error.is_transient() || tries >= MAX_TRIES => return Err(error),
            // From an outdated state each time, or from a server that does not send parts of a file.
            Ok(()) if tries >= MAX_TRIES => {
                let problem = format!(
                    "no part of the listed files was sent, {MAX_TRIES} times: a proxy answers with an old state or without ETag"
                );
                return Err(FetchError::Unexpected {
                    path: format!("/tar/{flight}.tar"),
                    problem,
                });
            }
            _ if tries > 0 => sleep(FIRST_PAUSE * 2_u32.pow(tries - 1)),
            // Complete, or from an outdated state: the next listing shows which.
            _ => {}
        }
    }
}

/// Groups files that are adjacent in the archive; each group is one request.
fn group_adjacent_files<'l, 'm>(missing: &'m [&'l ListedFile]) -> Vec<&'m [&'l ListedFile]> {
    let near = |a: &&ListedFile, b: &&ListedFile| {
        b.offset.saturating_sub(a.offset + a.length) <= MAX_GAP_BYTES
    };
    missing.chunk_by(near).collect()
}

/// Requests one group of files and stores each as soon as it has arrived.
fn fetch_run(
    client: &mut Client,
    listing: &Listing,
    run: &[&ListedFile],
    receiver: &Receiver,
    on_received: &mut dyn FnMut(u64),
) -> Result<(), FetchError> {
    let (Some(first), Some(last)) = (run.first(), run.last()) else {
        return Ok(());
    };
    let path = format!("/tar/{}.tar", listing.flight);
    let range = format!(
        "bytes={}-{}",
        first.offset,
        (last.offset + last.length).saturating_sub(1)
    );
    let headers = [
        (header::RANGE, range),
        (header::IF_RANGE, format!("\"{}\"", listing.digest)),
    ];
    let answer = client
        .get(&path, &headers)
        .map_err(FetchError::from_connection)?;
    let whole = answer.status == StatusCode::OK;
    let same_state = answer.headers.get(header::ETAG).map(HeaderValue::as_bytes)
        == Some(format!("\"{}\"", listing.digest).as_bytes());
    if whole && !same_state {
        return Ok(());
    }
    // Of the listed state, the whole archive comes from a proxy that does not pass ranges on.
    let (expected, mut at) = if whole {
        (StatusCode::OK, 0)
    } else {
        (StatusCode::PARTIAL_CONTENT, first.offset)
    };
    let mut bytes = ResponseBytes {
        answer: check_status(answer, &path, expected)?,
        rest: Bytes::new(),
    };
    for item in run {
        bytes
            .skip_bytes(item.offset - at)
            .map_err(FetchError::Broken)?;
        let mut file = receiver.begin_file(item)?;
        while file.missing_bytes() > 0 {
            let length = file.missing_bytes().min(PIECE_BYTES as u64);
            file.add(&bytes.read_bytes(length).map_err(FetchError::Broken)?)?;
        }
        file.finish()?;
        on_received(item.length);
        at = item.offset + item.length;
    }
    Ok(())
}

/// Body of a response, read in pieces of a requested length.
struct ResponseBytes<'a> {
    answer: ClientResponse<'a>,
    rest: Bytes,
}

impl ResponseBytes<'_> {
    fn for_each_part(&mut self, mut length: u64, mut part: impl FnMut(&[u8])) -> io::Result<()> {
        while length > 0 {
            if self.rest.is_empty() {
                self.rest = self
                    .answer
                    .next_chunk()?
                    .ok_or(io::ErrorKind::UnexpectedEof)?;
            }
            let count = self
                .rest
                .len()
                .min(usize::try_from(length).unwrap_or(usize::MAX));
            part(&self.rest.split_to(count));
            length -= count as u64;
        }
        Ok(())
    }

    fn skip_bytes(&mut self, length: u64) -> io::Result<()> {
        self.for_each_part(length, |_| ())
    }

    fn read_bytes(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.for_each_part(length, |part| bytes.extend_from_slice(part))?;
        Ok(bytes)
    }
}
