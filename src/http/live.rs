//! Live page: results relayed from the recorder's live socket to browsers.
//!
//! A slow browser misses results and delays nobody else.

use std::future::Future;
use std::io;
use std::path::Path;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use serde::Deserialize;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc::{Sender, channel, error::TrySendError};
use tokio::sync::watch;

use super::send::ChunkBody;
use super::{Refusal, ServerContext, pages, policy};

/// Maximum number of browsers that watch at the same time.
pub(super) const MAX_WATCHERS: usize = 16;
/// Maximum number of results queued for a slow browser.
const MAX_WAITING_RESULTS: usize = 4;
/// Pause before the next attempt to reach the recorder.
const RECONNECT_PAUSE: Duration = Duration::from_secs(2);
/// Timeout for a line of the recorder, which sends its state every second.
const MAX_SILENCE: Duration = Duration::from_secs(4);
/// Pause after which a browser that found the server full may retry, ms.
const RETRY_MS: u32 = 5000;
/// Timeout for the image of the newest frame.
const PICTURE_TIMEOUT: Duration = Duration::from_secs(5);
/// Script of the page.
pub(super) const SCRIPT: &str = include_str!("pages/live.js");

pub(super) async fn live_page(State(shared): ServerContext) -> Response {
    policy::scripted_page(pages::live_page(shared.site.live.is_some()))
}

/// Sends server-sent events: one JSON object per result, `state` every second, `down` with a reason while no recorder
/// answers. If the maximum number of browsers is reached, sends one event `full` and ends.
pub(super) async fn live_events(State(shared): ServerContext) -> Result<Response, Refusal> {
    let socket = shared.site.live.clone().ok_or(Refusal::NotFound)?;
    let (sender, receiver) = channel(MAX_WAITING_RESULTS);
    let Ok(permit) = shared.watchers.clone().try_acquire_owned() else {
        return Ok(event_stream_response(full_event()));
    };
    let closing = shared.closing.clone();
    tokio::spawn(async move {
        let _permit = permit;
        relay_events(&socket, &sender, closing).await;
    });
    Ok(event_stream_response(Body::new(ChunkBody(receiver))))
}

fn event_stream_response(body: Body) -> Response {
    let mut response = Response::new(body);
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("text/event-stream"),
    );
    response
}

/// Returns the event `full`. A refusal by HTTP status would stop the browser from retrying.
fn full_event() -> Body {
    let why = format!("{MAX_WATCHERS} browsers are already watching, which is the maximum");
    let data = serde_json::json!({ "reason": why });
    format!("retry: {RETRY_MS}\nevent: full\ndata: {data}\n\n").into()
}

/// Sends a small image of the newest frame; its headers hold the frame number and the frame's size.
pub(super) async fn newest_frame(State(shared): ServerContext) -> Result<Response, Refusal> {
    let socket = shared.site.live.clone().ok_or(Refusal::NotFound)?;
    let _one_of_few = shared
        .pictures_live
        .acquire()
        .await
        .map_err(|e| Refusal::Failed(e.to_string()))?;
    let picture = tokio::time::timeout(PICTURE_TIMEOUT, request_live_image(&socket)).await;
    let missing = |why: &str| (StatusCode::SERVICE_UNAVAILABLE, why.to_owned()).into_response();
    let Ok(Ok(picture)) = picture else {
        return Ok(missing("The recorder has no live frame at the moment."));
    };
    let jpeg = base64::engine::general_purpose::STANDARD.decode(&picture.jpeg);
    let jpeg = jpeg.map_err(|e| Refusal::Failed(e.to_string()))?;
    let mut response = Response::new(Body::from(jpeg));
    let value =
        |text: String| HeaderValue::try_from(text).map_err(|e| Refusal::Failed(e.to_string()));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg"));
    headers.insert(
        HeaderName::from_static("x-wingd-frame"),
        value(picture.frame.to_string())?,
    );
    let size = format!("{}x{}", picture.width, picture.height);
    headers.insert(HeaderName::from_static("x-wingd-size"), value(size)?);
    Ok(response)
}

/// Line of the live socket that carries an image.
#[derive(Deserialize)]
struct LiveImage {
    frame: u64,
    width: usize,
    height: usize,
    jpeg: String,
}

async fn connect_daemon_socket(
    socket: &Path,
) -> io::Result<(Lines<BufReader<OwnedReadHalf>>, OwnedWriteHalf)> {
    let (read, write) = UnixStream::connect(socket).await?.into_split();
    Ok((BufReader::new(read).lines(), write))
}

async fn request_live_image(socket: &Path) -> io::Result<LiveImage> {
    let (mut lines, mut write) = connect_daemon_socket(socket).await?;
    write.write_all(b"frame\n").await?;
    while let Some(line) = lines.next_line().await? {
        if let Some(picture) = picture_line(&line) {
            return serde_json::from_str(picture).map_err(Into::into);
        }
    }
    Err(io::ErrorKind::UnexpectedEof.into())
}

/// Returns the line if it carries an image, which its first key shows.
fn picture_line(line: &str) -> Option<&str> {
    line.starts_with("{\"frame\":").then_some(line)
}

/// Returns the JSON object of a line that carries the recorder's state.
fn state_object(line: &str) -> Option<&str> {
    line.strip_prefix("{\"state\":")?.strip_suffix('}')
}

fn down_event(why: &str) -> Bytes {
    let down = serde_json::json!({ "reason": why });
    format!("event: down\ndata: {down}\n\n").into()
}

/// Relays events until the browser disconnects or the server stops.
async fn relay_events(
    socket: &Path,
    to: &Sender<io::Result<Bytes>>,
    mut closing: watch::Receiver<bool>,
) {
    let work = async {
        while !to.is_closed() {
            let why = match relay_connection(socket, to).await {
                Ok(()) => "the recorder has stopped, or live mode is off".to_owned(),
                Err(error) => {
                    format!(
                        "cannot connect to a recorder in live mode at {}: {error}",
                        socket.display()
                    )
                }
            };
            if to.send(Ok(down_event(&why))).await.is_err() {
                return;
            }
            tokio::time::sleep(RECONNECT_PAUSE).await;
        }
    };
    tokio::select! { () = work => {}, _ = closing.wait_for(|closing| *closing) => {} }
}

/// Relays one connection to the recorder. `Ok` if the recorder or the browser has closed its end.
async fn relay_connection(socket: &Path, to: &Sender<io::Result<Bytes>>) -> io::Result<()> {
    // Dropping the writing half would close the connection.
    let (mut lines, mut write) = connect_daemon_socket(socket).await?;
    write.write_all(b"state\n").await?;
    loop {
        let event = match tokio::time::timeout(MAX_SILENCE, lines.next_line()).await {
            Err(_) => down_event("the recorder hangs: it is connected but sends nothing"),
            Ok(line) => match line? {
                None => return Ok(()),
                Some(line) if picture_line(&line).is_some() => continue,
                Some(line) => match state_object(&line) {
                    Some(state) => format!("event: state\ndata: {state}\n\n").into(),
                    None => format!("data: {line}\n\n").into(),
                },
            },
        };
        if let Err(TrySendError::Closed(_)) = to.try_send(Ok(event)) {
            return Ok(());
        }
    }
}

/// Maximum number of images requested at the same time.
pub(super) const MAX_PICTURES: usize = 4;

/// Wraps the shutdown future; the second value signals the shutdown to event streams.
pub(super) fn shutdown_signal(
    shutdown: impl Future<Output = ()>,
) -> (impl Future<Output = ()>, watch::Receiver<bool>) {
    let (closing, closed) = watch::channel(false);
    let then = async move {
        shutdown.await;
        // It is not an error if nobody is watching.
        let _ = closing.send(true);
    };
    (then, closed)
}
